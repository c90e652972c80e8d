//! The display room held to plain references: placement and scaling, the hash, Y4M bytes, PNG folders, and what
//! it says when there is no screen.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use vernissage::display::{
    Composer, Config, DisplayError, Filter, Kind, Layout, Rotate, Scale, Sink, Xrgb, Y4m, compose,
};
use vernissage::pixels::{Plane, Rgb, Size, SplitMix64, picture, simd};

fn noise(width: usize, height: usize) -> Rgb {
    let size = Size::new(width, height);
    let mut rng = SplitMix64::new(size.area() as u64);
    // padded rows: the display may not read past the width
    let plane = |rng: &mut SplitMix64| {
        let mut plane = Plane::with_stride(size, width + 3, 0xaa);
        (0..height).for_each(|y| plane.row_mut(y).fill_with(|| rng.next_u64() as u8));
        plane
    };
    Rgb { planes: [plane(&mut rng), plane(&mut rng), plane(&mut rng)] }
}

/// Canvas and mode sizes: equal, smaller, larger, wider, taller, one pixel, thin.
type Pair = (usize, usize);
const SIZES: &[(Pair, Pair)] = &[
    ((64, 48), (64, 48)),
    ((64, 48), (80, 60)),
    ((64, 48), (37, 91)),
    ((64, 48), (200, 51)),
    ((31, 77), (64, 64)),
    ((1, 1), (9, 5)),
    ((40, 1), (7, 7)),
    ((160, 120), (321, 241)),
    ((5, 4), (1, 1)),
];

#[test]
fn one_to_one_centers_and_crops() {
    for &((w, h), (mw, mh)) in SIZES {
        let (canvas, mode) = (noise(w, h), Size::new(mw, mh));
        let shown = compose(&canvas, mode, (Scale::OneToOne, Filter::Bilinear));
        for y in 0..mh {
            for x in 0..mw {
                // the canvas's middle lies on the mode's middle, halves rounded towards the top left
                let from = |o: usize, canvas: usize, mode: usize| {
                    let shift = if mode >= canvas {
                        -((mode - canvas) as i64 / 2)
                    } else {
                        (canvas - mode) as i64 / 2
                    };
                    usize::try_from(o as i64 + shift).ok().filter(|&i| i < canvas)
                };
                let expected = match (from(x, w, mw), from(y, h, mh)) {
                    (Some(x), Some(y)) => canvas.at(x, y),
                    _ => [0; 3],
                };
                assert_eq!(shown.at(x, y), expected, "{w}x{h} on {mode} at {x},{y}");
            }
        }
    }
}

/// The area that "fit" fills, from the definition: the largest rectangle of the canvas's proportions.
fn fitted(canvas: Size, mode: Size) -> (usize, usize, Size) {
    let ratio = (mode.width as f64 / canvas.width as f64).min(mode.height as f64 / canvas.height as f64);
    let side = |canvas: usize, mode: usize| ((canvas as f64 * ratio + 0.5).floor() as usize).clamp(1, mode);
    let size = Size::new(side(canvas.width, mode.width), side(canvas.height, mode.height));
    ((mode.width - size.width) / 2, (mode.height - size.height) / 2, size)
}

#[test]
fn fit_matches_the_plain_reference() {
    for &((w, h), (mw, mh)) in SIZES {
        let (canvas, mode) = (noise(w, h), Size::new(mw, mh));
        let (left, top, size) = fitted(canvas.size(), mode);
        let nearest = compose(&canvas, mode, (Scale::Fit, Filter::Nearest));
        let bilinear = compose(&canvas, mode, (Scale::Fit, Filter::Bilinear));
        for y in 0..mh {
            for x in 0..mw {
                let inside = (left..left + size.width).contains(&x) && (top..top + size.height).contains(&y);
                if !inside {
                    assert_eq!(nearest.at(x, y), [0; 3], "border of {w}x{h} on {mode} at {x},{y}");
                    assert_eq!(bilinear.at(x, y), [0; 3], "border of {w}x{h} on {mode} at {x},{y}");
                    continue;
                }
                let center =
                    |o: usize, input: usize, output: usize| (o as f64 + 0.5) * input as f64 / output as f64;
                let (u, v) = (center(x - left, w, size.width), center(y - top, h, size.height));
                assert_eq!(
                    nearest.at(x, y),
                    canvas.at(u as usize, v as usize),
                    "{w}x{h} on {mode} at {x},{y}"
                );
                for c in 0..3 {
                    let exact = bilinear_reference(&canvas.planes[c], u - 0.5, v - 0.5);
                    let error = (f64::from(bilinear.at(x, y)[c]) - (exact + 0.5).floor()).abs();
                    assert!(error <= 1.0, "{w}x{h} on {mode} at {x},{y}: off by {error} levels");
                }
            }
        }
    }
}

fn bilinear_reference(plane: &Plane<u8>, u: f64, v: f64) -> f64 {
    let Size { width, height } = plane.size();
    let (u, v) = (u.clamp(0.0, (width - 1) as f64), v.clamp(0.0, (height - 1) as f64));
    let (x, y) = (u.floor() as usize, v.floor() as usize);
    let (x1, y1) = ((x + 1).min(width - 1), (y + 1).min(height - 1));
    let mix = |a: u8, b: u8, t: f64| f64::from(a) * (1.0 - t) + f64::from(b) * t;
    let upper = mix(plane.at(x, y), plane.at(x1, y), u - u.floor());
    let lower = mix(plane.at(x, y1), plane.at(x1, y1), u - u.floor());
    upper * (1.0 - (v - v.floor())) + lower * (v - v.floor())
}

#[test]
fn every_level_and_thread_count_gives_the_same_bytes() {
    let canvas = noise(161, 119);
    for (scale, filter) in
        [(Scale::OneToOne, Filter::Bilinear), (Scale::Fit, Filter::Bilinear), (Scale::Fit, Filter::Nearest)]
    {
        let mode = Size::new(643, 481);
        let first = compose(&canvas, mode, (scale, filter));
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            for level in simd::available() {
                let mut composer = Composer::new(mode, (scale, filter)).at_level(level);
                let same = pool.install(|| *composer.compose(&canvas) == first);
                assert!(same, "{scale:?} {filter:?}: {} with {threads} threads", simd::name(level));
            }
        }
    }
}

#[test]
fn a_new_canvas_size_leaves_nothing_of_the_old_picture() {
    let mode = Size::new(64, 48);
    let mut composer = Composer::new(mode, (Scale::OneToOne, Filter::Bilinear));
    composer.compose(&noise(64, 48));
    let small = noise(20, 10);
    assert_eq!(*composer.compose(&small), compose(&small, mode, (Scale::OneToOne, Filter::Bilinear)));
    assert_eq!(*composer.compose(&Rgb::default()), Xrgb::new(mode));
}

#[test]
fn hash_is_the_documented_one() {
    let mut canvas = Rgb::new(Size::new(2, 1), [0; 3]);
    canvas.set(0, 0, [0x12, 0x34, 0x56]);
    let shown = compose(&canvas, canvas.size(), (Scale::OneToOne, Filter::Bilinear));
    let mut expected = 0xcbf2_9ce4_8422_2325u64;
    for word in [2, 1, 0x12_34_56, 0] {
        expected = (expected ^ word).wrapping_mul(0x100_0000_01b3);
    }
    assert_eq!(shown.hash(), expected);
    assert_ne!(Xrgb::new(Size::new(1, 2)).hash(), Xrgb::new(Size::new(2, 1)).hash());
}

/// A writer that keeps what was written, or fails once `room` bytes are full.
#[derive(Clone)]
struct Memory {
    bytes: Arc<Mutex<Vec<u8>>>,
    room: usize,
    error: std::io::ErrorKind,
}

impl Write for Memory {
    fn write(&mut self, part: &[u8]) -> std::io::Result<usize> {
        let mut bytes = self.bytes.lock().expect("one thread");
        if bytes.len() + part.len() > self.room {
            return Err(self.error.into());
        }
        bytes.extend(part);
        Ok(part.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

fn memory(room: usize, error: std::io::ErrorKind) -> Memory {
    Memory { bytes: Arc::default(), room, error }
}

#[test]
fn y4m_has_header_frames_and_full_range_values() {
    let out = memory(usize::MAX, std::io::ErrorKind::Other);
    let canvas = noise(7, 5);
    let mut clip = Y4m::start(Box::new(out.clone()), Path::new("-"), canvas.size(), (25, 1)).expect("header");
    clip.write(&canvas).expect("frame");
    clip.write(&canvas).expect("frame");
    let bytes = out.bytes.lock().expect("one thread").clone();
    let end = bytes.iter().position(|&b| b == b'\n').expect("header line") + 1;
    let header = std::str::from_utf8(&bytes[..end]).expect("text");
    assert!(header.starts_with("YUV4MPEG2 W7 H5 F25:1 "), "{header}");
    assert!(header.contains(" C444 ") && header.trim_end().ends_with("XCOLORRANGE=FULL"), "{header}");
    let frame = 6 + 3 * 35;
    assert_eq!(bytes.len(), end + 2 * frame);
    assert_eq!(bytes[end..end + frame], bytes[end + frame..]);
    assert_eq!(&bytes[end..end + 6], b"FRAME\n");
    for (i, (x, y)) in (0..5).flat_map(|y| (0..7).map(move |x| (x, y))).enumerate() {
        let [r, g, b] = canvas.at(x, y).map(f64::from);
        let luma = 0.299 * r + 0.587 * g + 0.114 * b;
        let expected = [luma, (b - luma) / 1.772 + 128.0, (r - luma) / 1.402 + 128.0];
        for (c, expected) in expected.into_iter().enumerate() {
            let error = (f64::from(bytes[end + 6 + c * 35 + i]) - expected.clamp(0.0, 255.0)).abs();
            assert!(error <= 0.5 + 1e-9, "plane {c} at {x},{y}: {error}");
        }
    }
}

#[test]
fn y4m_names_a_full_disk_a_gone_reader_and_a_new_size() {
    let canvas = noise(8, 8);
    let start = |out: Memory| Y4m::start(Box::new(out), Path::new("clip.y4m"), canvas.size(), (30, 1));
    let full = start(memory(200, std::io::ErrorKind::StorageFull)).and_then(|mut clip| clip.write(&canvas));
    let full = full.expect_err("no room").to_string();
    assert!(full.starts_with("clip.y4m: cannot write") && full.contains("free space"), "{full}");
    let gone = start(memory(200, std::io::ErrorKind::BrokenPipe)).and_then(|mut clip| clip.write(&canvas));
    assert!(matches!(gone, Err(DisplayError::ReaderGone { .. })), "{gone:?}");
    let size = start(memory(9999, std::io::ErrorKind::Other)).and_then(|mut clip| clip.write(&noise(9, 8)));
    let size = size.expect_err("other size").to_string();
    assert!(size.contains("8x8") && size.contains("9x8"), "{size}");
}

/// A folder of its own for one test, removed with the test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        let _ = std::fs::remove_dir_all(&path);
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[test]
fn png_folder_holds_every_frame() {
    let folder = Folder::new("display-png");
    let config = Config { sink: Kind::Png, path: Some(folder.0.join("deep")), ..Config::default() };
    let mut sink = Sink::open(&config, Size::new(4, 3)).expect("folder");
    let frames = [noise(4, 3), noise(5, 2)];
    for frame in &frames {
        sink.present(frame).expect("written");
    }
    for (i, frame) in frames.iter().enumerate() {
        let read = picture::read(&folder.0.join(format!("deep/frame-{i:06}.png"))).expect("read back");
        assert_eq!(read, *frame);
    }
    assert_eq!(sink.scan_out_hash(), None);
}

#[test]
fn files_that_cannot_be_written_are_named() {
    let missing = PathBuf::from("/nonexistent/folder/clip.y4m");
    let config = Config { sink: Kind::Y4m, path: Some(missing), ..Config::default() };
    let error = Sink::open(&config, Size::new(4, 4)).expect_err("no folder").to_string();
    assert!(error.starts_with("/nonexistent/folder/clip.y4m: cannot write"), "{error}");
    let error = Sink::open(&Config { path: None, ..config }, Size::new(4, 4)).expect_err("no path");
    assert!(error.to_string().contains("display.path"), "{error}");
}

#[test]
#[cfg(target_os = "linux")]
fn a_missing_screen_says_what_was_looked_at() {
    let config = Config { card: "/dev/dri/card63".into(), ..Config::default() };
    let error = Sink::open(&config, Size::new(640, 480)).expect_err("no such card").to_string();
    assert!(error.starts_with("no display: /dev/dri/card63: not there"), "{error}");
    assert!(error.contains("display.sink"), "{error}");
    let config = Config { card: "/dev/null".into(), ..Config::default() };
    let error = Sink::open(&config, Size::new(640, 480)).expect_err("not a card").to_string();
    assert!(error.starts_with("no display: /dev/null: not a display card"), "{error}");
}

#[test]
fn turned_and_doubled_pictures_are_placed_as_any() {
    let (canvas, mode) = (noise(64, 48), Size::new(131, 70));
    for rotate in [Rotate::None, Rotate::Right, Rotate::Half, Rotate::Left] {
        for (scale, mirror) in [(Scale::OneToOne, false), (Scale::Fit, true)] {
            let layout = Layout { scale, rotate, mirror, ..Layout::default() };
            let mut turned = Rgb::default();
            layout.turn(&canvas, &mut turned);
            let plain = (scale, Filter::Bilinear);
            assert!(compose(&canvas, mode, layout) == compose(&turned, mode, plain), "{layout:?}");
            // two lenses: each half is a screen of its own, an odd last column stays black
            let both = compose(&canvas, mode, Layout { stereo: true, ..layout });
            let one = compose(&turned, Size::new(65, 70), plain);
            for (y, x) in (0..70).flat_map(|y| (0..65).map(move |x| (y, x))) {
                assert_eq!([both.at(x, y), both.at(x + 65, y)], [one.at(x, y); 2], "{layout:?} at {x},{y}");
            }
            assert!((0..70).all(|y| both.at(130, y) == [0; 3]));
        }
    }
}

#[test]
fn settings_read_and_refuse() {
    let read = toml::from_str::<Config>;
    let text = "sink = 'kms'\ncard = '/dev/dri/card1'\nmode = '800x480'\nscale = 'fit'\nfilter = 'nearest'";
    let config = read(text).expect("all keys");
    assert_eq!(config.mode.map(|m| m.0), Some(Size::new(800, 480)));
    assert_eq!((config.scale, config.filter, config.fps), (Scale::Fit, Filter::Nearest, 30));
    assert_eq!(read("").expect("defaults"), Config::default());
    let visor = read("rotate = 270\nmirror = true\nstereo = true").expect("all keys").layout();
    assert_eq!((visor.rotate, visor.mirror, visor.stereo), (Rotate::Left, true, true));
    assert!(read("rotate = 45").expect_err("no such turn").to_string().contains("rotate = 45: give 0, 90"));
    assert!(read("colour = 1").expect_err("unknown key").to_string().contains("colour"));
    let error = read("mode = '800*480'").expect_err("bad mode").to_string();
    assert!(error.contains("640x480"), "{error}");
}

#[test]
fn null_takes_anything() {
    let config = Config { sink: Kind::Null, ..Config::default() };
    let mut sink = Sink::open(&config, Size::new(640, 480)).expect("null");
    let first = sink.present(&noise(3, 3)).expect("shown").at;
    assert!(sink.present(&noise(9, 9)).expect("shown").at >= first);
}
