//! The newest good frame out of a ring of driver buffers, and the accounts of those that were not shown.
//!
//! Knows buffers only through `Buffers`, so that every path (damage, shortage, silence, loss) is tested
//! without hardware.

use super::raw::{Decoder, RawFormat, RawRef};
use crate::frame::Frame;
use std::io;
use std::time::{Duration, Instant};

/// A buffer the driver handed over.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dequeued {
    /// Which buffer.
    pub index: usize,
    /// Bytes filled.
    pub used: usize,
    /// The driver says the contents are damaged.
    pub damaged: bool,
    /// The driver's running number.
    pub sequence: u32,
    /// On the monotonic clock; `None` when the driver stamps by another clock.
    pub taken_at: Option<Duration>,
}

/// A ring of buffers shared with a driver.
pub(super) trait Buffers {
    /// How many there are.
    fn count(&self) -> usize;
    /// Waits until a buffer may be ready; `false` on time-out.
    fn wait(&mut self, timeout: Duration) -> io::Result<bool>;
    /// Takes a filled buffer, `None` when there is none.
    fn dequeue(&mut self) -> io::Result<Option<Dequeued>>;
    /// The filled bytes of a dequeued buffer.
    fn bytes(&self, buffer: &Dequeued) -> &[u8];
    /// Gives a buffer back to the driver.
    fn queue(&mut self, index: usize) -> io::Result<()>;
}

/// Where the source's frames went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stats {
    /// Buffers or pictures received.
    pub received: u64,
    /// Frames handed on.
    pub delivered: u64,
    /// Never arrived: gaps in the running number.
    pub missed: u64,
    /// Good, but a newer one was there.
    pub stale: u64,
    /// Marked damaged by the driver.
    pub damaged: u64,
    /// Fewer bytes than the format needs.
    pub short: u64,
    /// Could not be decoded (MJPEG).
    pub undecodable: u64,
    /// The running number repeated or stepped back.
    pub disordered: u64,
}

/// Turns a driver's 32-bit running number, which may wrap, repeat or step back, into one that only grows.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sequence {
    last: Option<(u32, i64, u64)>,
}

impl Sequence {
    /// The number of the next buffer; counts gaps and disorder.
    pub(super) fn next(&mut self, raw: u32, stats: &mut Stats) -> u64 {
        let Some((last_raw, last_at, last_out)) = self.last else {
            self.last = Some((raw, i64::from(raw), u64::from(raw)));
            return u64::from(raw);
        };
        // the difference as a signed 32-bit number survives wrapping
        let step = i64::from(raw.wrapping_sub(last_raw) as i32);
        let at = last_at + step;
        let out = (last_out + 1).max(u64::try_from(at).unwrap_or(0));
        stats.missed += out - last_out - 1;
        stats.disordered += u64::from(step <= 0);
        self.last = Some((raw, at, out));
        out
    }
}

/// What a stream remembers between frames.
pub(super) struct Grabber {
    pub format: RawFormat,
    pub decoder: Decoder,
    pub stats: Stats,
    /// Where a copy of the raw bytes goes, when wanted.
    pub raw: Option<Vec<u8>>,
    sequence: Sequence,
    /// A failure to give a buffer back after a good frame: told at the next call.
    fault: Option<io::Error>,
}

impl Grabber {
    pub(super) fn new(format: RawFormat) -> Self {
        Self {
            format,
            decoder: Decoder::default(),
            stats: Stats::default(),
            raw: None,
            sequence: Sequence::default(),
            fault: None,
        }
    }

    /// The stream begins anew: its running number may begin anywhere.
    pub(super) fn restarted(&mut self) {
        (self.sequence, self.fault) = (Sequence::default(), None);
    }

    /// Decodes the newest good buffer into `frame`; `false` when none came in time. `frame` keeps its
    /// picture unless `true` is returned.
    pub(super) fn grab(
        &mut self,
        ring: &mut impl Buffers,
        frame: &mut Frame,
        timeout: Duration,
        now: impl Fn() -> Duration,
    ) -> io::Result<bool> {
        if let Some(fault) = self.fault.take() {
            return Err(fault);
        }
        let deadline = Instant::now() + timeout;
        let mut woken = false;
        loop {
            let before = self.stats.received;
            let newest = self.drain(ring)?;
            if let Some((buffer, sequence)) = newest {
                let raw = RawRef { format: self.format, bytes: ring.bytes(&buffer) };
                let decoded = self.decoder.decode(&raw, frame);
                if decoded.is_ok()
                    && let Some(copy) = &mut self.raw
                {
                    copy.clear();
                    copy.extend_from_slice(raw.bytes);
                }
                let requeued = ring.queue(buffer.index);
                match decoded {
                    Ok(()) => {
                        // a stamp can lie ahead of the clock by a frame's exposure in some drivers
                        let now = now();
                        frame.sequence = sequence;
                        frame.captured_at = buffer.taken_at.map_or(now, |at| at.min(now));
                        self.stats.delivered += 1;
                        self.fault = requeued.err();
                        return Ok(true);
                    }
                    Err(error) => {
                        log::debug!("frame {sequence} dropped: {error}");
                        self.stats.undecodable += 1;
                        requeued?;
                    }
                }
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(false);
            }
            // an error condition makes `wait` return at once, again and again, with nothing to dequeue
            if woken && self.stats.received == before {
                std::thread::sleep(Duration::from_millis(1).min(left));
            }
            woken = ring.wait(left)?;
        }
    }

    /// Empties the ring; keeps the newest good buffer and gives the others back.
    fn drain(&mut self, ring: &mut impl Buffers) -> io::Result<Option<(Dequeued, u64)>> {
        let mut newest: Option<(Dequeued, u64)> = None;
        for _ in 0..ring.count() {
            let Some(buffer) = ring.dequeue()? else { break };
            self.stats.received += 1;
            let sequence = self.sequence.next(buffer.sequence, &mut self.stats);
            let short = self.format.least_bytes().is_none_or(|least| buffer.used < least);
            if buffer.damaged || short {
                self.stats.damaged += u64::from(buffer.damaged);
                self.stats.short += u64::from(!buffer.damaged);
                ring.queue(buffer.index)?;
            } else if let Some((old, _)) = newest.replace((buffer, sequence)) {
                self.stats.stale += 1;
                ring.queue(old.index)?;
            }
        }
        Ok(newest)
    }
}

#[cfg(test)]
#[path = "grab_tests.rs"]
mod tests;
