//! The steps that styles share, each alone: time of the fast form, largest distance from its f64 reference.

use super::{Bench, Times};
use crate::app::say;
use crate::kernel::{area, bilateral, canny, color, enlarge, photometric, pyramid, sobel, voronoi};
use crate::pixels::{Plane, Rgb, Size, SplitMix64, simd};

/// One step, measured.
pub struct Step {
    name: &'static str,
    detail: &'static str,
    times: Times,
    error: f64,
    unit: &'static str,
}

impl Step {
    /// One line of the table.
    pub fn print(&self, threads: usize, json: bool) -> anyhow::Result<()> {
        let ms = |d: std::time::Duration| d.as_secs_f64() * 1e3;
        let (min, median) = (ms(self.times.min), ms(self.times.median));
        let Self { name, detail, error, unit, .. } = self;
        if json {
            return say(serde_json::json!({
                "step": name, "detail": detail, "threads": threads, "min_ms": min, "median_ms": median,
                "error": error, "unit": unit,
            }));
        }
        let error =
            if *unit == "mismatches" { format!("{error:.0}") } else { format!("at most {error:.1e}") };
        say(format_args!("{name:<18} {detail:<36} {threads:>7} {min:>9.3} {median:>9.3}  {error} {unit}"))
    }
}

const LEVELS: &str = "levels";
const MISMATCHES: &str = "mismatches";

/// Pixels of `size` at which references are evaluated: enough to see, few enough to wait for.
fn probes(size: Size) -> impl Iterator<Item = (usize, usize)> {
    let stride = (size.area() / 4001).max(1) | 1;
    (0..size.area()).step_by(stride).map(move |i| (i % size.width, i / size.width))
}

fn worst(errors: impl Iterator<Item = f64>) -> f64 {
    errors.fold(0.0, f64::max)
}

/// Every step on the bench's first frame.
pub fn all(bench: &Bench) -> Vec<Step> {
    let picture = &bench.frames[0].color;
    let size = picture.size();
    let level = simd::best();
    let small = Size::new(size.width * 3 / 8, size.height * 3 / 8);
    let mut steps = Vec::new();
    let mut step = |name, detail, times, error, unit| steps.push(Step { name, detail, times, error, unit });

    let [mut shrunk, mut yuv, mut out] = <[[Plane<f32>; 3]; 3]>::default();
    shrunk.iter_mut().for_each(|plane| plane.resize(small, 0.0));
    let mut shrink = area::Shrink::default();
    let times = bench.time(|_| {
        for (from, to) in picture.planes.iter().zip(&mut shrunk) {
            shrink.run(level, from.view(), to);
        }
    });
    let plane = picture.planes[0].view();
    let error = probes(small)
        .map(|(x, y)| 255.0 * (f64::from(shrunk[0].at(x, y)) - area::reference(plane, small, x, y)).abs());
    step("area average", "three channels, to 3/8", times, worst(error), LEVELS);

    let times = bench.time(|_| color::rgb_to_yuv(level, picture, &mut yuv));
    let error = probes(size).map(|(x, y)| {
        let truth = color::reference(picture.at(x, y));
        worst((0..3).map(|c| 255.0 * (f64::from(yuv[c].at(x, y)) - truth[c]).abs()))
    });
    step("RGB to YUV", "eq. of BT.601", times, worst(error), LEVELS);

    let sigma = 0.025f32;
    let gain = photometric::chroma_gain(sigma);
    let bytes = |p: &Plane<f32>| Plane::from_fn(small, |x, y| (p.at(x, y) * 255.0) as u8);
    let mut small_yuv = <[Plane<f32>; 3]>::default();
    color::rgb_to_yuv(level, &Rgb { planes: shrunk.each_ref().map(bytes) }, &mut small_yuv);
    let scaled = [1.0, gain, gain];
    let scaled: [Plane<f32>; 3] =
        std::array::from_fn(|c| Plane::from_fn(small, |x, y| small_yuv[c].at(x, y) * scaled[c]));
    let times = bench.time(|_| photometric::step(level, &scaled, &mut out));
    let error = probes(small).map(|(x, y)| {
        let truth = photometric::reference(&small_yuv, f64::from(sigma), x, y);
        255.0 * (f64::from(out[0].at(x, y)) - truth[0]).abs()
    });
    step("photometric", "one step of 5x5, at 3/8", times, worst(error), LEVELS);

    let (mut gx, mut gy) = (Plane::default(), Plane::default());
    let times = bench.time(|_| sobel::gradients(level, plane, &mut gx, &mut gy));
    let error = probes(size).map(|(x, y)| {
        let at = |x, y| f64::from(plane.at(x, y));
        let truth = sobel::reference(size.width, size.height, x, y, at);
        (f64::from(gx.at(x, y)) / 4.0 - truth[0]).abs().max((f64::from(gy.at(x, y)) / 4.0 - truth[1]).abs())
    });
    step("Sobel", "one channel", times, worst(error), LEVELS);

    let mut large = Plane::new(size, 0.0);
    let times = bench.time(|_| enlarge::enlarge(level, shrunk[0].view(), &mut large));
    let error = probes(size).map(|(x, y)| {
        255.0 * (f64::from(large.at(x, y)) - enlarge::reference(shrunk[0].view(), size, x, y)).abs()
    });
    step("enlarge", "one channel, bilinear from 3/8", times, worst(error), LEVELS);

    let (mut down, mut half, mut up, mut back) =
        (pyramid::Down::default(), Plane::default(), pyramid::Up::default(), Plane::default());
    let times = bench.time(|_| down.run(level, plane, &mut half));
    let byte = |x, y| f64::from(plane.at(x, y)) / 255.0;
    let error = probes(half.size())
        .map(|(x, y)| 255.0 * (f64::from(half.at(x, y)) - pyramid::down_reference(size, x, y, byte)).abs());
    step("pyramid down", "one channel", times, worst(error), LEVELS);
    let times = bench.time(|_| up.run(level, &half, size, &mut back));
    let float = |x, y| f64::from(half.at(x, y));
    let error = probes(size).map(|(x, y)| {
        255.0 * (f64::from(back.at(x, y)) - pyramid::up_reference(half.size(), x, y, float)).abs()
    });
    step("pyramid up", "one channel", times, worst(error), LEVELS);

    let quarter = Size::new(size.width / 4, size.height / 4);
    let source: [Plane<f32>; 3] = std::array::from_fn(|c| {
        Plane::from_fn(quarter, |x, y| f32::from(picture.planes[c].at(4 * x, 4 * y)) / 255.0)
    });
    let (mut filter, mut filtered) = (bilateral::Bilateral::default(), source.clone());
    let times = bench.time(|_| filter.step(level, 2.0, 0.1, &mut filtered));
    filtered.clone_from(&source);
    filter.step(level, 2.0, 0.1, &mut filtered);
    let error = probes(quarter).map(|(x, y)| {
        let at = |x, y| source.each_ref().map(|plane| f64::from(plane.at(x, y)));
        let truth = bilateral::reference(quarter, 2.0, f64::from(0.1f32), x, y, at);
        worst((0..3).map(|c| 255.0 * (f64::from(filtered[c].at(x, y)) - truth[c]).abs()))
    });
    step("bilateral", "one step of 9x9, at 1/4", times, worst(error), LEVELS);

    let mut edges = canny::Canny::default();
    let times = bench.time(|_| {
        edges.mark(level, picture, 105, 150);
        edges.connect();
    });
    let gray = Plane::from_fn(size, |x, y| canny::gray(picture.at(x, y)));
    let truth = canny::reference(&gray, 105, 150);
    let all = (0..size.area()).map(|i| (i % size.width, i / size.width));
    let error = all.filter(|&(x, y)| edges.is_edge(x, y) != truth.at(x, y)).count() as f64;
    step("Canny", "", times, error, MISMATCHES);

    let mut random = SplitMix64::new(2008);
    let cells = (0..size.area() / 64).map(|i| {
        let (column, row) = (i % (size.width / 8), i / (size.width / 8));
        [column, row].map(|at| (at * 128) as i32 + random.int(0, 127) as i32)
    });
    let mut sites: Vec<[i32; 2]> = cells.collect();
    let mut labels = voronoi::Voronoi::default();
    let wrong = |labels: &voronoi::Voronoi, sites: &[[i32; 2]]| {
        probes(size).filter(|&(x, y)| labels.row(y)[x] != voronoi::reference(sites, x, y)).count() as f64
    };
    let times = bench.time(|_| {
        labels.forget();
        labels.run(level, size, &sites);
    });
    step("Voronoi labels", "4800 sites", times, wrong(&labels, &sites), MISMATCHES);
    // what re-tiling of a picture that has come to rest still does
    let mut frame = 0;
    let times = bench.time(|_| {
        frame += 1;
        for site in sites.iter_mut().skip(frame % 7 * 13).step_by(97) {
            *site = site.map(|v| v ^ 3);
        }
        labels.run(level, size, &sites);
    });
    step("Voronoi labels", "50 of 4800 sites moved", times, wrong(&labels, &sites), MISMATCHES);
    steps
}
