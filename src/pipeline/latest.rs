//! Newest wins: the hand-over from the camera's thread to the pipeline's.
//!
//! Three buffers circulate. The writer fills one, `publish` swaps it for the one in the middle; the reader
//! swaps the middle one for its own when it is fresh. Neither ever waits for the other, no picture is
//! copied, and a reader that is late sees only the newest: latency stays under one frame however slow it is.
//! Ownership follows from one atomic exchange of slot numbers, so the slots' mutexes are never contended;
//! they exist only to let safe Rust hand out `&mut`.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Set in the middle slot's number while it holds something the reader has not seen.
const FRESH: u32 = 4;

struct Shared<T> {
    slots: [Mutex<T>; 3],
    /// Slot number in the middle, `FRESH` when unread.
    middle: AtomicU32,
    /// How many were published and never read.
    replaced: AtomicU64,
    /// Set when the writer is gone.
    ended: AtomicBool,
    reader: std::thread::Thread,
}

/// The end that fills buffers.
pub struct Writer<T> {
    shared: Arc<Shared<T>>,
    own: u32,
}

/// The end that takes the newest.
pub struct Reader<T> {
    shared: Arc<Shared<T>>,
    own: u32,
}

/// A hand-over whose reader runs on the thread `reader`; the three buffers start as copies of `empty`.
pub fn latest<T: Clone>(empty: T, reader: std::thread::Thread) -> (Writer<T>, Reader<T>) {
    let slots = [Mutex::new(empty.clone()), Mutex::new(empty.clone()), Mutex::new(empty)];
    let shared = Arc::new(Shared {
        slots,
        middle: AtomicU32::new(1),
        replaced: AtomicU64::new(0),
        ended: AtomicBool::new(false),
        reader,
    });
    (Writer { shared: shared.clone(), own: 0 }, Reader { shared, own: 2 })
}

fn slot<T>(shared: &Shared<T>, own: u32) -> MutexGuard<'_, T> {
    // never contended, see the module's head; a panic on the other end leaves a whole value behind
    shared.slots[own as usize].lock().unwrap_or_else(PoisonError::into_inner)
}

impl<T> Writer<T> {
    /// The buffer to fill next; what it holds is some older value.
    pub fn buffer(&mut self) -> MutexGuard<'_, T> {
        slot(&self.shared, self.own)
    }

    /// Makes the filled buffer the newest and wakes the reader.
    pub fn publish(&mut self) {
        let before = self.shared.middle.swap(self.own | FRESH, Ordering::AcqRel);
        if before & FRESH != 0 {
            self.shared.replaced.fetch_add(1, Ordering::Relaxed);
        }
        self.own = before & !FRESH;
        self.shared.reader.unpark();
    }

    /// Whether the reader is gone.
    pub fn is_abandoned(&self) -> bool {
        Arc::strong_count(&self.shared) == 1
    }
}

impl<T> Drop for Writer<T> {
    /// Wakes the reader: nothing more will come.
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::Release);
        self.shared.reader.unpark();
    }
}

impl<T> Reader<T> {
    /// Waits up to `timeout` for something not yet seen; `None` when nothing came, at once when the writer is
    /// gone.
    pub fn next(&mut self, timeout: Duration) -> Option<MutexGuard<'_, T>> {
        let deadline = Instant::now() + timeout;
        loop {
            // asked before the middle is looked at: what was published last is still taken
            let ended = self.is_abandoned();
            if self.shared.middle.load(Ordering::Acquire) & FRESH != 0 {
                break;
            }
            if ended {
                return None;
            }
            let left = deadline.checked_duration_since(Instant::now())?;
            std::thread::park_timeout(left);
        }
        self.own = self.shared.middle.swap(self.own, Ordering::AcqRel) & !FRESH;
        Some(slot(&self.shared, self.own))
    }

    /// How many were published and replaced before they were read.
    pub fn replaced(&self) -> u64 {
        self.shared.replaced.load(Ordering::Relaxed)
    }

    /// Whether the writer is gone.
    pub fn is_abandoned(&self) -> bool {
        self.shared.ended.load(Ordering::Acquire)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_wins_and_the_rest_is_counted() {
        let (mut writer, mut reader) = latest(0u32, std::thread::current());
        assert!(reader.next(Duration::ZERO).is_none());
        for value in 1..=3 {
            *writer.buffer() = value;
            writer.publish();
        }
        assert_eq!(reader.next(Duration::ZERO).as_deref(), Some(&3));
        assert_eq!(reader.replaced(), 2);
        assert!(reader.next(Duration::ZERO).is_none(), "seen once only");
    }

    #[test]
    fn the_last_value_is_taken_and_the_end_is_told_at_once() {
        let (mut writer, mut reader) = latest(0u32, std::thread::current());
        *writer.buffer() = 7;
        writer.publish();
        drop(writer);
        assert_eq!(reader.next(Duration::from_secs(60)).as_deref(), Some(&7));
        let asked = Instant::now();
        assert!(reader.next(Duration::from_secs(60)).is_none() && reader.is_abandoned());
        assert!(asked.elapsed() < Duration::from_secs(30));
    }

    #[test]
    fn a_running_writer_is_never_seen_half_done_or_backwards() {
        const LAST: u64 = 200_000;
        let (mut writer, mut reader) = latest([0u64; 8], std::thread::current());
        std::thread::scope(|scope| {
            scope.spawn(move || {
                for value in 1..=LAST {
                    *writer.buffer() = [value; 8];
                    writer.publish();
                }
            });
            let mut last = 0;
            while last < LAST {
                let seen = reader.next(Duration::from_secs(20)).expect("writer runs");
                assert!(seen.iter().all(|&v| v == seen[0]), "torn value {seen:?}");
                assert!(seen[0] > last, "went back from {last} to {}", seen[0]);
                last = seen[0];
            }
        });
        assert!(reader.is_abandoned());
    }
}
