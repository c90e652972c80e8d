//! Test-only: the sizes, contents, SIMD levels and thread counts every kernel is held to its reference on.
//!
//! A kernel's test loops over `cases()`, runs its fast form inside `everywhere` (which asserts that all levels
//! and thread counts give equal results and returns that result) and compares with its f64 reference.

use crate::pixels::{Plane, Size, SplitMix64, simd};
use fearless_simd::Level;

/// One channel of test content, its rows padded with junk.
pub struct Case {
    /// Content and size, for messages.
    pub label: String,
    /// The samples.
    pub plane: Plane<u8>,
}

/// Every content at every size: 1x1, thin, odd, and (one content) 1280x720.
pub fn cases() -> Vec<Case> {
    let sizes =
        [(1, 1), (2, 1), (1, 3), (3, 2), (5, 5), (8, 4), (17, 9), (33, 31), (64, 48), (67, 45), (160, 120)];
    let mut cases = Vec::new();
    for (w, h) in sizes {
        for content in ["flat", "ramp", "impulse", "checkerboard", "noise", "photograph"] {
            cases.push(case(content, Size::new(w, h)));
        }
    }
    cases.push(case("photograph", Size::new(1280, 720)));
    cases
}

/// One content at one size.
pub fn case(content: &'static str, size: Size) -> Case {
    let mut rng = SplitMix64::new(size.area() as u64);
    let photo = photograph();
    let mut plane = Plane::with_stride(size, size.width + 5, 0);
    for junk in plane.samples_mut() {
        *junk = rng.next_u64() as u8 | 1;
    }
    for y in 0..size.height {
        for x in 0..size.width {
            plane.row_mut(y)[x] = match content {
                "flat" => 93,
                "ramp" => ((x * 3 + y * 5) % 256) as u8,
                "impulse" => 255 * u8::from(x == size.width / 2 && y == size.height / 2),
                "checkerboard" => 255 * ((x + y) % 2) as u8,
                "noise" => rng.next_u64() as u8,
                _ => photo.at(mirror(x, photo.size().width), mirror(y, photo.size().height)),
            };
        }
    }
    Case { label: format!("{content} {size}"), plane }
}

/// Runs `f` at every SIMD level and with 1, 2 and 4 threads; asserts equal results and returns them.
pub fn everywhere<T: PartialEq + Send>(label: &str, f: impl Fn(Level) -> T + Sync) -> T {
    let mut first = None;
    for threads in [1, 2, 4] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("test pool");
        for level in simd::available() {
            let result = pool.install(|| f(level));
            let same = first.as_ref().is_none_or(|first| *first == result);
            assert!(same, "{label}: {} with {threads} threads differs from scalar with 1", simd::name(level));
            first.get_or_insert(result);
        }
    }
    first.expect("at least one level")
}

/// Green channel of a small photograph.
fn photograph() -> Plane<u8> {
    let bytes = include_bytes!("../../tests/data/filters/micro_coffee_160x120.png");
    let decoded = image::load_from_memory(bytes).expect("embedded photograph").into_rgb8();
    let size = Size::new(decoded.width() as usize, decoded.height() as usize);
    Plane::from_fn(size, |x, y| decoded.get_pixel(x as u32, y as u32).0[1])
}

fn mirror(i: usize, n: usize) -> usize {
    let i = i % (2 * n);
    if i < n { i } else { 2 * n - 1 - i }
}
