//! The V4L2 device and its buffers: the ioctls that the `v4l` crate lacks or that panic on values it does
//! not know, and the request/queue/dequeue/map loop.
//!
//! Comes in: a device node; goes out: safe calls that give `io::Error`s. A buffer's bytes can be borrowed
//! only while the buffer is ours (dequeued), so nobody reads memory that the driver writes. Nothing here
//! decides anything: see `v4l2.rs`.
#![allow(unsafe_code)]

use super::controls::{Control, plain_name};
use super::grab::{Buffers, Dequeued};
use std::io::{Error, ErrorKind, Result};
use std::os::raw::c_void;
use std::path::Path;
use std::time::Duration;
use v4l::v4l_sys as sys;
use v4l::v4l2::{self, vidioc};

const CAPTURE: u32 = sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE;
const MMAP: u32 = sys::v4l2_memory_V4L2_MEMORY_MMAP;
/// `poll`'s "there is something to read" and "there is an event", `mmap`'s read, write, shared: one value on all of
/// Linux.
const POLLIN: i16 = 1;
const POLLPRI: i16 = 2;
const PROT_READ_WRITE: i32 = 3;
const MAP_SHARED: i32 = 1;
/// A driver that lists more formats, or hands out more buffers, is broken.
const MOST: u32 = 64;

/// Two ioctls that the crate does not list: `_IOR('V', 89, struct v4l2_event)` and `_IOW('V', 90, struct
/// v4l2_event_subscription)` of `linux/videodev2.h`.
const VIDIOC_DQEVENT: vidioc::_IOC_TYPE = request(2, size_of::<sys::v4l2_event>(), 89);
const VIDIOC_SUBSCRIBE_EVENT: vidioc::_IOC_TYPE = request(1, size_of::<sys::v4l2_event_subscription>(), 90);

/// `_IOC` of `asm-generic/ioctl.h`: direction, size, type, number.
const fn request(direction: u32, size: usize, number: u32) -> vidioc::_IOC_TYPE {
    (direction << 30 | (size as u32) << 16 | (b'V' as u32) << 8 | number) as vidioc::_IOC_TYPE
}

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

/// Structs of videodev2.h: integers, arrays, unions and raw pointers only.
///
/// # Safety
/// All zero bytes must be a valid value.
unsafe trait Plain: Copy {}
// SAFETY: no references, no enums, no niches in any of them.
unsafe impl Plain for sys::v4l2_capability {}
// SAFETY: as above.
unsafe impl Plain for sys::v4l2_fmtdesc {}
// SAFETY: as above.
unsafe impl Plain for sys::v4l2_format {}
// SAFETY: as above.
unsafe impl Plain for sys::v4l2_pix_format {}
// SAFETY: as above.
unsafe impl Plain for sys::v4l2_requestbuffers {}
// SAFETY: as above.
unsafe impl Plain for sys::v4l2_buffer {}
// SAFETY: as above.
unsafe impl Plain for sys::v4l2_queryctrl {}
// SAFETY: as above.
unsafe impl Plain for sys::v4l2_event {}
// SAFETY: as above.
unsafe impl Plain for sys::v4l2_event_subscription {}

fn zeroed<T: Plain>() -> T {
    // SAFETY: `Plain` promises that zeros are valid.
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
        let mut stream = Stream { device: self.0, buffers: Vec::new(), changed: false };
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
        let mut wish = sys::v4l2_event_subscription { type_: sys::V4L2_EVENT_SOURCE_CHANGE, ..zeroed() };
        // SAFETY: SUBSCRIBE_EVENT takes a v4l2_event_subscription. Cameras without such events refuse: nothing lost.
        let _ = unsafe { ioctl(&stream.device, VIDIOC_SUBSCRIBE_EVENT, &mut wish) };
        stream.start()?;
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
    /// The source has another signal than when the stream was started.
    changed: bool,
}

impl Stream {
    /// Queues every buffer that is ours and starts.
    fn start(&mut self) -> Result<()> {
        for index in 0..self.buffers.len() {
            self.queue(index)?;
        }
        let mut kind = CAPTURE;
        // SAFETY: STREAMON takes an int-sized buffer type.
        unsafe { ioctl(&self.device, vidioc::VIDIOC_STREAMON, &mut kind) }
    }

    /// Stops, takes every buffer back and starts again.
    pub(super) fn restart(&mut self) -> Result<()> {
        let mut kind = CAPTURE;
        // SAFETY: STREAMOFF takes an int-sized buffer type; it gives all buffers back to us.
        unsafe { ioctl(&self.device, vidioc::VIDIOC_STREAMOFF, &mut kind)? };
        self.buffers.iter_mut().for_each(|buffer| buffer.ours = true);
        self.start()
    }
}

impl Stream {
    /// Whether the source has another signal (size, rate) than when the stream was started.
    pub(super) fn has_changed(&self) -> bool {
        self.changed
    }

    /// Takes the events that wait.
    fn hear(&mut self) {
        for _ in 0..MOST {
            let mut event: sys::v4l2_event = zeroed();
            // SAFETY: DQEVENT takes a v4l2_event.
            if unsafe { ioctl(&self.device, VIDIOC_DQEVENT, &mut event) }.is_err() {
                break;
            }
            // SAFETY: all variants are integers, zero where the kernel wrote less.
            let changes = unsafe { event.u.src_change.changes };
            let size = sys::V4L2_EVENT_SRC_CH_RESOLUTION;
            self.changed |= event.type_ == sys::V4L2_EVENT_SOURCE_CHANGE && changes & size != 0;
            if event.pending == 0 {
                break;
            }
        }
    }

    /// The controls that can be set, in the driver's order.
    pub(super) fn controls(&self) -> Vec<Control> {
        let mut found = Vec::new();
        let mut id = 0;
        for _ in 0..16 * MOST {
            let mut query = sys::v4l2_queryctrl { id: id | sys::V4L2_CTRL_FLAG_NEXT_CTRL, ..zeroed() };
            // SAFETY: QUERYCTRL takes a v4l2_queryctrl.
            let asked = unsafe { ioctl(&self.device, vidioc::VIDIOC_QUERYCTRL, &mut query) };
            // a driver that does not go on would never end
            if asked.is_err() || query.id <= id {
                break;
            }
            id = query.id;
            let fixed = sys::V4L2_CTRL_FLAG_DISABLED | sys::V4L2_CTRL_FLAG_READ_ONLY;
            if query.flags & fixed == 0 {
                let end = query.name.iter().position(|&b| b == 0).unwrap_or(query.name.len());
                found.push(Control {
                    id,
                    name: plain_name(&String::from_utf8_lossy(&query.name[..end])),
                    min: query.minimum.into(),
                    max: query.maximum.into(),
                    step: i64::from(query.step).max(1),
                });
            }
        }
        found
    }

    /// What a control is set to.
    pub(super) fn control(&self, id: u32) -> Result<i64> {
        let mut control = sys::v4l2_control { id, value: 0 };
        // SAFETY: G_CTRL takes a v4l2_control.
        unsafe { ioctl(&self.device, vidioc::VIDIOC_G_CTRL, &mut control)? };
        Ok(control.value.into())
    }

    /// Sets a control; what it then holds.
    pub(super) fn set_control(&self, id: u32, value: i64) -> Result<i64> {
        let value = i32::try_from(value).map_err(|_| Error::from(ErrorKind::InvalidInput))?;
        let mut control = sys::v4l2_control { id, value };
        // SAFETY: S_CTRL takes a v4l2_control.
        unsafe { ioctl(&self.device, vidioc::VIDIOC_S_CTRL, &mut control)? };
        self.control(id)
    }
}

impl Buffers for Stream {
    fn count(&self) -> usize {
        self.buffers.len()
    }

    fn wait(&mut self, timeout: Duration) -> Result<bool> {
        let ms = timeout.as_micros().div_ceil(1000).min(60_000) as i32;
        match self.device.handle().poll(POLLIN | POLLPRI, ms) {
            Ok(ready) => {
                if ready > 0 {
                    self.hear();
                }
                Ok(ready > 0)
            }
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
