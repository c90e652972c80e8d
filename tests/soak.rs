//! Two million frames, small and accelerated: none lost, none doubled, nothing allocated, memory flat. A twentieth of
//! them unless `VERNISSAGE_SOAK` is set.
//!
//! The counter is the process's global allocator, so this test has a binary of its own.

#[path = "common/counting.rs"]
mod counting;

use counting::{watch, watched};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use vernissage::display::{Composer, Filter, Layout as Place, Rotate, Scale, Sink};
use vernissage::frame::Frame;
use vernissage::geometry::Lens;
use vernissage::pipeline::governor::{self, Governor};
use vernissage::pipeline::{Pipeline, latest};
use vernissage::pixels::{Size, simd};
use vernissage::scene::Scene;
use vernissage::style::{self, StyleName};

const SIZE: Size = Size::new(64, 48);

/// Resident memory, bytes.
fn resident() -> u64 {
    let pages = std::fs::read_to_string("/proc/self/statm").expect("Linux");
    let pages: u64 = pages.split(' ').nth(1).and_then(|n| n.parse().ok()).expect("a number");
    pages * 4096
}

/// The sequence number as the brightness of twenty squares of the picture: what is drawn says which frame it is.
fn paint(sequence: u64, frame: &mut Frame) {
    frame.resize(SIZE);
    frame.sequence = sequence;
    frame.captured_at = Duration::from_nanos(33_333_333) * sequence as u32;
    for y in 0..SIZE.height {
        for x in 0..SIZE.width {
            let bit = y / 12 * 8 + x / 8;
            let value = if sequence >> bit & 1 == 1 { 220 } else { 30 };
            frame.luma.row_mut(y)[x] = value;
            frame.color.planes.iter_mut().for_each(|plane| plane.row_mut(y)[x] = value);
        }
    }
}

#[test]
fn two_million_frames() {
    let all = std::env::var_os("VERNISSAGE_SOAK").is_some();
    let frames: u64 = if all { 2_000_000 } else { 100_000 };
    let cycle = vec![StyleName::Plain, StyleName::SketchLike];
    let config = style::Config { name: StyleName::Plain, cycle, fade_ms: 0, ..style::Config::default() };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().expect("a pool");
    pool.install(|| {
        let lens = Lens::guess(SIZE);
        let mut pipeline =
            Pipeline::new(Scene::default(), lens, Default::default(), &config, simd::best()).governed();
        let mut governor = Governor::new(&governor::Config { budget_ms: 33.0 });
        let layout =
            Place { scale: Scale::OneToOne, filter: Filter::Bilinear, rotate: Rotate::Half, mirror: true, stereo: true };
        let mut composer = Composer::new(Size::new(2 * SIZE.width, SIZE.height), layout);
        let mut sink = Sink::Null;
        // one frame at a time: the source waits until the last one was taken
        let (mut writer, mut reader) = latest(Frame::default(), std::thread::current());
        let taken = AtomicU64::new(0);
        std::thread::scope(|scope| {
            let taken = &taken;
            let warm = 2_000;
            let source = scope.spawn(move || {
                watch();
                for sequence in 0..frames {
                    while taken.load(Ordering::Acquire) < sequence {
                        std::thread::park();
                    }
                    paint(sequence, &mut writer.buffer());
                    writer.publish();
                }
            });
            // all work is done on these two threads
            watch();
            let (mut next, mut before, mut memory) = (0, 0, 0);
            while next < frames {
                let frame = reader.next(Duration::from_secs(60)).expect("the source runs");
                assert_eq!(frame.sequence, next, "lost or doubled");
                // now and then another style, as a visitor would have it; the plain one shows the number
                let plain = next / 500 % 2 == 0;
                if next % 500 == 0 && next > 0 {
                    pipeline.step_style(1);
                }
                let drawn = pipeline.draw_frame(&frame);
                if plain {
                    let bit = |k: usize| u64::from(drawn.canvas.at(k % 8 * 8 + 4, k / 8 * 12 + 6)[0] > 128) << k;
                    assert_eq!((0..32).map(bit).sum::<u64>(), next, "another frame's picture");
                }
                let cost = drawn.timings.frame();
                composer.compose(drawn.canvas);
                sink.present(drawn.canvas).expect("nowhere takes everything");
                if let Some(quality) = governor.observe(cost, pipeline.forms(), frame.captured_at) {
                    pipeline.set_quality(quality);
                }
                drop(frame);
                next += 1;
                if next == warm {
                    memory = resident();
                    before = watched();
                }
                taken.store(next, Ordering::Release);
                source.thread().unpark();
            }
            source.join().expect("the source ends");
            let allocated = watched() - before;
            let grown = resident().saturating_sub(memory);
            eprintln!("{frames} frames: {allocated} allocations after the first {warm}, memory grew by {grown} bytes");
            assert_eq!(allocated, 0);
            // the kernel counts pages in batches
            assert!(grown <= 1 << 20, "{grown} bytes");
            assert_eq!((reader.replaced(), next), (0, frames));
        });
    });
}
