//! A driver played from a script: every way a ring of buffers can behave, without hardware.

use super::*;
use crate::camera::PixelFormat;
use crate::pixels::Size;
use std::collections::VecDeque;

/// What the driver does next.
#[derive(Clone, Copy)]
enum Event {
    /// Fills a buffer with this gray and this number.
    Filled(u8, u32),
    /// The same, marked damaged.
    Damaged(u32),
    /// The same, with this many bytes.
    Short(u32, usize),
    /// Nothing to dequeue now.
    Pause,
    /// Dequeueing fails.
    Error(i32),
}
use Event::*;

struct Ring {
    script: VecDeque<Event>,
    contents: Vec<Vec<u8>>,
    queued: Vec<bool>,
    stamp: Option<Duration>,
    refuse_queue: bool,
    always_ready: bool,
    waits: usize,
}

impl Ring {
    fn new(script: &[Event]) -> Self {
        let contents = vec![vec![0; 12]; 4];
        let script = script.iter().copied().collect();
        let stamp = Some(Duration::from_secs(5));
        let queued = vec![true; 4];
        Self { script, contents, queued, stamp, refuse_queue: false, always_ready: false, waits: 0 }
    }
}

impl Buffers for Ring {
    fn count(&self) -> usize {
        4
    }

    fn wait(&mut self, timeout: Duration) -> io::Result<bool> {
        self.waits += 1;
        if self.script.is_empty() && !self.always_ready {
            std::thread::sleep(timeout);
            return Ok(false);
        }
        Ok(true)
    }

    fn dequeue(&mut self) -> io::Result<Option<Dequeued>> {
        let Some(index) = self.queued.iter().position(|&q| q) else { return Ok(None) };
        let (value, sequence, used, damaged) = match self.script.pop_front() {
            None | Some(Pause) => return Ok(None),
            Some(Error(code)) => return Err(io::Error::from_raw_os_error(code)),
            Some(Filled(value, sequence)) => (value, sequence, 12, false),
            Some(Damaged(sequence)) => (0, sequence, 12, true),
            Some(Short(sequence, used)) => (0, sequence, used, false),
        };
        self.contents[index].fill(value);
        self.queued[index] = false;
        Ok(Some(Dequeued { index, used, damaged, sequence, taken_at: self.stamp }))
    }

    fn bytes(&self, buffer: &Dequeued) -> &[u8] {
        assert!(!self.queued[buffer.index], "read while the driver owns it");
        &self.contents[buffer.index][..buffer.used]
    }

    fn queue(&mut self, index: usize) -> io::Result<()> {
        assert!(!self.queued[index], "queued twice");
        if self.refuse_queue {
            return Err(io::Error::from_raw_os_error(22));
        }
        self.queued[index] = true;
        Ok(())
    }
}

/// 4x3 gray, full range, so that a buffer's value is the luma.
fn grabber() -> Grabber {
    let mut format = RawFormat::new(PixelFormat::Grey, Size::new(4, 3));
    format.coding.range = crate::kernel::yuv::Range::Full;
    Grabber::new(format)
}

fn grab(grabber: &mut Grabber, ring: &mut Ring, frame: &mut Frame) -> io::Result<bool> {
    grabber.grab(ring, frame, Duration::from_millis(5), || Duration::from_secs(6))
}

#[test]
fn the_newest_frame_is_taken_and_the_others_go_back() {
    let mut ring = Ring::new(&[Filled(10, 0), Filled(20, 1), Filled(30, 2), Pause, Filled(40, 3)]);
    let (mut grabber, mut frame) = (grabber(), Frame::default());
    assert!(grab(&mut grabber, &mut ring, &mut frame).expect("a frame"));
    assert_eq!((frame.luma.at(0, 0), frame.sequence), (30, 2));
    assert_eq!(frame.captured_at, Duration::from_secs(5));
    assert!(ring.queued.iter().all(|&q| q), "all buffers are back");
    assert!(grab(&mut grabber, &mut ring, &mut frame).expect("a frame"));
    assert_eq!((frame.luma.at(3, 2), frame.sequence), (40, 3));
    let wanted = Stats { received: 4, delivered: 2, stale: 2, ..Stats::default() };
    assert_eq!(grabber.stats, wanted);
}

#[test]
fn damaged_and_short_buffers_are_dropped_and_counted() {
    let mut ring =
        Ring::new(&[Filled(10, 0), Pause, Damaged(1), Short(2, 11), Short(3, 0), Pause, Filled(50, 4)]);
    let (mut grabber, mut frame) = (grabber(), Frame::default());
    assert!(grab(&mut grabber, &mut ring, &mut frame).expect("a frame"));
    assert!(grab(&mut grabber, &mut ring, &mut frame).expect("a frame"));
    assert_eq!((frame.luma.at(0, 0), frame.sequence), (50, 4));
    let wanted = Stats { received: 5, delivered: 2, damaged: 1, short: 2, ..Stats::default() };
    assert_eq!(grabber.stats, wanted);
    assert!(ring.queued.iter().all(|&q| q));
}

#[test]
fn silence_is_a_time_out_and_the_stream_goes_on() {
    let mut ring = Ring::new(&[]);
    let (mut grabber, mut frame) = (grabber(), Frame::default());
    frame.sequence = 77;
    for _ in 0..2 {
        assert!(!grab(&mut grabber, &mut ring, &mut frame).expect("no error"));
    }
    assert_eq!(frame.sequence, 77, "the frame stays");
    ring.script.push_back(Filled(9, 100));
    assert!(grab(&mut grabber, &mut ring, &mut frame).expect("a frame"));
}

#[test]
fn a_device_that_is_always_ready_and_never_has_anything_does_not_spin() {
    let mut ring = Ring::new(&[]);
    ring.always_ready = true;
    let (mut grabber, mut frame) = (grabber(), Frame::default());
    assert!(!grab(&mut grabber, &mut ring, &mut frame).expect("no error"));
    assert!(ring.waits <= 8, "{} waits in 5 ms", ring.waits);
}

#[test]
fn errors_come_through() {
    for code in [19, 5] {
        let mut ring = Ring::new(&[Error(code)]);
        let error = grab(&mut grabber(), &mut ring, &mut Frame::default()).expect_err("an error");
        assert_eq!(error.raw_os_error(), Some(code));
    }
}

#[test]
fn a_frame_whose_buffer_cannot_go_back_is_still_shown() {
    let mut ring = Ring::new(&[Filled(10, 0)]);
    ring.refuse_queue = true;
    let (mut grabber, mut frame) = (grabber(), Frame::default());
    assert!(grab(&mut grabber, &mut ring, &mut frame).expect("the frame"));
    let error = grab(&mut grabber, &mut ring, &mut frame).expect_err("then the error");
    assert_eq!(error.raw_os_error(), Some(22));
}

#[test]
fn stamps_of_the_future_or_of_another_clock_become_now() {
    for stamp in [Some(Duration::from_secs(6) + Duration::from_millis(28)), None] {
        let mut ring = Ring::new(&[Filled(10, 0)]);
        ring.stamp = stamp;
        let mut frame = Frame::default();
        assert!(grab(&mut grabber(), &mut ring, &mut frame).expect("a frame"));
        assert_eq!(frame.captured_at, Duration::from_secs(6));
    }
}

#[test]
fn the_raw_copy_decodes_to_the_same_frame() {
    let mut ring = Ring::new(&[Filled(123, 0)]);
    let (mut grabber, mut frame, mut again) = (grabber(), Frame::default(), Frame::default());
    grabber.raw = Some(Vec::new());
    assert!(grab(&mut grabber, &mut ring, &mut frame).expect("a frame"));
    let bytes = grabber.raw.as_deref().expect("kept");
    crate::camera::decode(&RawRef { format: grabber.format, bytes }, &mut again).expect("decodes");
    assert!(again.luma == frame.luma && again.color == frame.color);
}

#[test]
fn broken_mjpeg_is_dropped_and_the_last_good_frame_stays() {
    let mut ring = Ring::new(&[Filled(0xd8, 0)]);
    let (mut grabber, mut frame) = (grabber(), Frame::default());
    grabber.format = RawFormat::new(PixelFormat::Mjpg, Size::new(4, 3));
    frame.resize(Size::new(4, 3));
    frame.luma.fill(99);
    assert!(!grab(&mut grabber, &mut ring, &mut frame).expect("no error"));
    assert_eq!(frame.luma.at(1, 1), 99);
    assert_eq!(grabber.stats.undecodable, 1);
    assert!(ring.queued.iter().all(|&q| q));
}

#[test]
fn running_numbers_grow_whatever_the_driver_says() {
    let table: [(&[u32], &[u64], u64, u64); 6] = [
        (&[0, 1, 2], &[0, 1, 2], 0, 0),
        (&[5, 8], &[5, 8], 2, 0),
        (&[5, 5, 6, 7], &[5, 6, 7, 8], 0, 1),
        (&[5, 6, 5, 7, 9], &[5, 6, 7, 8, 9], 0, 1),
        (&[u32::MAX, 0, 2], &[0xffff_ffff, 0x1_0000_0000, 0x1_0000_0002], 1, 0),
        (&[9, 0, 1], &[9, 10, 11], 0, 1),
    ];
    for (raw, wanted, missed, disordered) in table {
        let (mut sequence, mut stats) = (Sequence::default(), Stats::default());
        let out: Vec<u64> = raw.iter().map(|&r| sequence.next(r, &mut stats)).collect();
        assert_eq!(out, wanted, "{raw:?}");
        assert_eq!((stats.missed, stats.disordered), (missed, disordered), "{raw:?}");
    }
}
