//! Each stage of a frame under criterion, for watching one change closely: `cargo bench`.
//!
//! The table of time against error is `vernissage bench`; this gives confidence intervals on the same frames.

use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use vernissage::camera::{Synthetic, SyntheticConfig};
use vernissage::frame::Frame;
use vernissage::marker::Family;
use vernissage::pixels::{Rgb, Size, simd};
use vernissage::style::{self, StyleInput, StyleName, Styler};
use vernissage::track::{Tracker, Wanted};

fn stages(criterion: &mut Criterion) {
    let mut camera = Synthetic::new(&SyntheticConfig::default(), Size::new(640, 480), 30.0, simd::best());
    let lens = camera.lens();
    let mut frame = Frame::default();
    assert!(camera.next(&mut frame), "the synthetic camera is endless");

    let mut tracker = Tracker::new(Default::default(), simd::best());
    let wanted = [Wanted { family: Family::Tag36h11, id: Some(7), side_mm: 80.0 }];
    criterion.bench_function("track tag36h11", |b| {
        b.iter(|| black_box(tracker.find(frame.luma.view(), &lens, &wanted).len()));
    });
    for &name in StyleName::ALL {
        let mut styler = Styler::new(&style::Config { name, ..Default::default() }, simd::best());
        let mut canvas = Rgb::new(frame.size(), [0; 3]);
        criterion.bench_function(&format!("style {name}"), |b| {
            b.iter(|| styler.draw(StyleInput { frame: &frame, layer: None }, black_box(&mut canvas)));
        });
    }
}

criterion_group!(benches, stages);
criterion_main!(benches);
