//! The V4L2 device and its buffers: the ioctls that the `v4l` crate lacks or that panic on values it does
//! not know, and the request/queue/dequeue/map loop.
//!
//! Comes in: a device node; goes out: safe calls that give `io::Error`s. A buffer's bytes can be borrowed
//! only while the buffer is ours (dequeued), so nobody reads memory that the driver writes. Nothing here
//! decides anything: see `v4l2.rs`.
#![allow(unsafe_code)]

use super::grab::{Buffers, Dequeued};
use std::io::{Error, ErrorKind, Result};
use std::os::raw::c_void;
use std::path::Path;
use std::time::Duration;
use v4l::v4l_sys as sys;
use v4l::v4l2::{self, vidioc};

const CAPTURE: u32 = sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE;
const MMAP: u32 = sys::v4l2_memory_V4L2_MEMORY_MMAP;
/// `poll`'s "there is something to read" and `mmap`'s read, write, shared: one value on all of Linux.
const POLLIN: i16 = 1;
const PROT_READ_WRITE: i32 = 3;
const MAP_SHARED: i32 = 1;
/// A driver that lists more formats, or hands out more buffers, is broken.
const MOST: u32 = 64;

/// An open video node.
pub(super) struct Device(v4l::Device);

/// What a node says it is.
#[derive(Clone, Debug)]
pub(super) struct Capability {
    pub driver: String,
    pub card: String,
    pub flags: u32,
}

/// The picture format as the driver holds it; numbers as in `linux/videodev2.h`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct DriverFormat {
    pub width: u32,
    pub height: u32,
    pub fourcc: u32,
    pub field: u32,
    pub bytes_per_line: u32,
    pub size_image: u32,
    pub colorspace: u32,
    pub encoding: u32,
    pub quantization: u32,
}

/// # Safety
/// `request` must be the ioctl whose argument is a `T`.
unsafe fn ioctl<T>(device: &v4l::Device, request: vidioc::_IOC_TYPE, argument: &mut T) -> Result<()> {
    // SAFETY: the caller vouches that the kernel reads and writes a T here, and `argument` is one.
    unsafe { v4l2::ioctl(device.handle().fd(), request, std::ptr::from_mut(argument).cast::<c_void>()) }
}

fn zeroed<T: Copy>() -> T {
    // SAFETY: used only for the plain integer structs and unions of videodev2.h, for which zeros are valid.
    unsafe { std::mem::zeroed() }
}

impl Device {
    /// Opens a node for streaming without blocking.
    pub(super) fn open(path: &Path) -> Result<Self> {
        if path.as_os_str().as_encoded_bytes().contains(&0) {
            return Err(Error::new(ErrorKind::InvalidInput, "a path cannot contain NUL"));
        }
        v4l::Device::with_path(path).map(Device)
    }

    /// The underlying device, for the crate's enumerations.
    pub(super) fn inner(&self) -> &v4l::Device {
        &self.0
    }

    /// Driver, card and capability bits of this node.
    pub(super) fn capability(&self) -> Result<Capability> {
        let mut caps: sys::v4l2_capability = zeroed();
        // SAFETY: QUERYCAP takes a v4l2_capability.
        unsafe { ioctl(&self.0, vidioc::VIDIOC_QUERYCAP, &mut caps)? };
        let text = |bytes: &[u8]| {
            let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
            String::from_utf8_lossy(&bytes[..end]).into_owned()
        };
        let own = caps.capabilities & sys::V4L2_CAP_DEVICE_CAPS != 0;
        let flags = if own { caps.device_caps } else { caps.capabilities };
        Ok(Capability { driver: text(&caps.driver), card: text(&caps.card), flags })
    }

    /// FourCCs of the capture formats, in the driver's order.
    pub(super) fn formats(&self) -> Vec<u32> {
        let mut found = Vec::new();
        for index in 0..MOST {
            let mut description = sys::v4l2_fmtdesc { index, type_: CAPTURE, ..zeroed() };
            // SAFETY: ENUM_FMT takes a v4l2_fmtdesc.
            if unsafe { ioctl(&self.0, vidioc::VIDIOC_ENUM_FMT, &mut description) }.is_err() {
                break;
            }
            found.push(description.pixelformat);
        }
        found
    }

    /// Asks for a size and format, then reads what the driver really set.
    pub(super) fn set_format(&self, width: u32, height: u32, fourcc: u32) -> Result<DriverFormat> {
        let mut format = sys::v4l2_format { type_: CAPTURE, ..zeroed() };
        format.fmt.pix = sys::v4l2_pix_format {
            width,
            height,
            pixelformat: fourcc,
            field: sys::v4l2_field_V4L2_FIELD_NONE,
            priv_: sys::V4L2_PIX_FMT_PRIV_MAGIC,
            ..zeroed()
        };
        // SAFETY: S_FMT takes a v4l2_format.
        unsafe { ioctl(&self.0, vidioc::VIDIOC_S_FMT, &mut format)? };
        let mut format = sys::v4l2_format { type_: CAPTURE, ..zeroed() };
        // SAFETY: G_FMT takes a v4l2_format.
        unsafe { ioctl(&self.0, vidioc::VIDIOC_G_FMT, &mut format)? };
        // SAFETY: for a capture type the kernel fills `pix`, which is all integers anyway.
        let (pix, encoding) = unsafe { (format.fmt.pix, format.fmt.pix.__bindgen_anon_1.ycbcr_enc) };
        Ok(DriverFormat {
            width: pix.width,
            height: pix.height,
            fourcc: pix.pixelformat,
            field: pix.field,
            bytes_per_line: pix.bytesperline,
            size_image: pix.sizeimage,
            colorspace: pix.colorspace,
            encoding,
            quantization: pix.quantization,
        })
    }

    /// Requests, maps and queues `count` buffers and starts the stream.
    pub(super) fn stream(self, count: u32) -> Result<Stream> {
        let mut request = sys::v4l2_requestbuffers { count, type_: CAPTURE, memory: MMAP, ..zeroed() };
        // SAFETY: REQBUFS takes a v4l2_requestbuffers.
        unsafe { ioctl(&self.0, vidioc::VIDIOC_REQBUFS, &mut request)? };
        // from here on dropping the stream gives the buffers back
        let mut stream = Stream { device: self.0, buffers: Vec::new() };
        if !(2..=MOST).contains(&request.count) {
            return Err(Error::other(format!("the driver offers {} buffers", request.count)));
        }
        for index in 0..request.count {
            let mut buffer = sys::v4l2_buffer { index, type_: CAPTURE, memory: MMAP, ..zeroed() };
            // SAFETY: QUERYBUF takes a v4l2_buffer.
            unsafe { ioctl(&stream.device, vidioc::VIDIOC_QUERYBUF, &mut buffer)? };
            // SAFETY: with MMAP memory the kernel fills `offset`.
            let offset = unsafe { buffer.m.offset };
            stream
                .buffers
                .push(Buffer { map: Mapping::new(&stream.device, buffer.length, offset)?, ours: true });
        }
        for index in 0..stream.buffers.len() {
            stream.queue(index)?;
        }
        let mut kind = CAPTURE;
        // SAFETY: STREAMON takes an int-sized buffer type.
        unsafe { ioctl(&stream.device, vidioc::VIDIOC_STREAMON, &mut kind)? };
        Ok(stream)
    }
}

/// One driver buffer in our address space.
struct Mapping {
    start: *mut c_void,
    length: usize,
}

// SAFETY: a mapping is plain shared memory, tied to no thread; access goes through `Stream`'s borrows.
unsafe impl Send for Mapping {}

impl Mapping {
    fn new(device: &v4l::Device, length: u32, offset: u32) -> Result<Self> {
        let length = length as usize;
        let fd = device.handle().fd();
        // SAFETY: a fresh mapping chosen by the kernel; nothing else refers to it.
        let start = unsafe {
            v4l2::mmap(std::ptr::null_mut(), length, PROT_READ_WRITE, MAP_SHARED, fd, i64::from(offset))?
        };
        Ok(Self { start, length })
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: exactly the region that `new` mapped; borrows of it end before the stream is dropped.
        let _ = unsafe { v4l2::munmap(self.start, self.length) };
    }
}

struct Buffer {
    map: Mapping,
    /// Dequeued: the driver does not touch it.
    ours: bool,
}

/// A running stream. Dropping it stops the stream and frees the buffers, whatever state the device is in.
pub(super) struct Stream {
    device: v4l::Device,
    buffers: Vec<Buffer>,
}

impl Buffers for Stream {
    fn count(&self) -> usize {
        self.buffers.len()
    }

    fn wait(&mut self, timeout: Duration) -> Result<bool> {
        let ms = timeout.as_micros().div_ceil(1000).min(60_000) as i32;
        match self.device.handle().poll(POLLIN, ms) {
            Ok(ready) => Ok(ready > 0),
            Err(error) if error.kind() == ErrorKind::Interrupted => Ok(false),
            Err(error) => Err(error),
        }
    }

    fn dequeue(&mut self) -> Result<Option<Dequeued>> {
        let mut buffer = sys::v4l2_buffer { type_: CAPTURE, memory: MMAP, ..zeroed() };
        // SAFETY: DQBUF takes a v4l2_buffer.
        match unsafe { ioctl(&self.device, vidioc::VIDIOC_DQBUF, &mut buffer) } {
            Ok(()) => {}
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => return Ok(None),
            Err(error) => return Err(error),
        }
        let index = buffer.index as usize;
        let Some(ours) = self.buffers.get_mut(index) else {
            return Err(Error::new(ErrorKind::InvalidData, format!("the driver names buffer {index}")));
        };
        ours.ours = true;
        let clock = buffer.flags & sys::V4L2_BUF_FLAG_TIMESTAMP_MASK;
        let seconds = u64::try_from(buffer.timestamp.tv_sec).unwrap_or(0);
        let micros = u64::try_from(buffer.timestamp.tv_usec).unwrap_or(0);
        Ok(Some(Dequeued {
            index,
            used: (buffer.bytesused as usize).min(ours.map.length),
            damaged: buffer.flags & sys::V4L2_BUF_FLAG_ERROR != 0,
            sequence: buffer.sequence,
            taken_at: (clock == sys::V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC)
                .then(|| Duration::from_secs(seconds).saturating_add(Duration::from_micros(micros))),
        }))
    }

    fn bytes(&self, buffer: &Dequeued) -> &[u8] {
        match self.buffers.get(buffer.index) {
            // SAFETY: the mapping is `length` bytes long and lives as long as `self`; the buffer is dequeued,
            // so the driver does not write it, and queueing it needs `&mut self`, which ends this borrow.
            Some(b) if b.ours => unsafe {
                std::slice::from_raw_parts(b.map.start.cast::<u8>(), buffer.used.min(b.map.length))
            },
            _ => &[],
        }
    }

    fn queue(&mut self, index: usize) -> Result<()> {
        let mut buffer = sys::v4l2_buffer { index: index as u32, type_: CAPTURE, memory: MMAP, ..zeroed() };
        let Some(ours) = self.buffers.get_mut(index).filter(|b| b.ours) else {
            return Err(Error::new(ErrorKind::InvalidInput, format!("buffer {index} is not ours to queue")));
        };
        ours.ours = false;
        // SAFETY: QBUF takes a v4l2_buffer.
        let queued = unsafe { ioctl(&self.device, vidioc::VIDIOC_QBUF, &mut buffer) };
        if queued.is_err() {
            self.buffers[index].ours = true;
        }
        queued
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        let mut kind = CAPTURE;
        // SAFETY: STREAMOFF takes an int-sized buffer type. It fails when the device is gone: nothing to do.
        let _ = unsafe { ioctl(&self.device, vidioc::VIDIOC_STREAMOFF, &mut kind) };
        self.buffers.clear();
        let mut request = sys::v4l2_requestbuffers { count: 0, type_: CAPTURE, memory: MMAP, ..zeroed() };
        // SAFETY: REQBUFS takes a v4l2_requestbuffers; 0 frees the buffers, which are unmapped by now.
        let _ = unsafe { ioctl(&self.device, vidioc::VIDIOC_REQBUFS, &mut request) };
    }
}
