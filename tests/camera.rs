//! Clips, traces and format choice from outside: what a user's files and drivers can do to us.

use std::io::{BufReader, Cursor};
use std::path::{Path, PathBuf};
use std::time::Duration;
use vernissage::camera::negotiate::{Granted, Offer, Wish, coding, granted, rank};
use vernissage::camera::trace::{Entry, Writer};
use vernissage::camera::{self, Clip, Config, Grab, Kind, PixelFormat, RawFormat, RawRef, Source};
use vernissage::frame::Frame;
use vernissage::kernel::yuv::{Coding, Matrix, Range, Samples, Siting, reference};
use vernissage::pixels::{PlaneRef, Rgb, Size, SplitMix64, picture};

const NOW: Duration = Duration::ZERO;

/// A folder of its own for each test, emptied first.
fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("camera").join(name);
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).expect("a folder in the target directory");
    path
}

fn noise(n: usize, seed: u64) -> Vec<u8> {
    let mut rng = SplitMix64::new(seed);
    (0..n).map(|_| rng.next_u64() as u8).collect()
}

/// A clip of `frames` frames of noise, and the bytes of each.
fn y4m(tags: &str, size: Size, bytes: usize, frames: usize) -> (Vec<u8>, Vec<Vec<u8>>) {
    let mut clip = format!("YUV4MPEG2 W{} H{} F25:1 {tags}\n", size.width, size.height).into_bytes();
    let pictures: Vec<Vec<u8>> = (0..frames).map(|i| noise(bytes, i as u64)).collect();
    for picture in &pictures {
        clip.extend_from_slice(b"FRAME Ip\n");
        clip.extend_from_slice(picture);
    }
    (clip, pictures)
}

fn open(bytes: Vec<u8>) -> Result<Clip, camera::CameraError> {
    Clip::y4m(Box::new(BufReader::new(Cursor::new(bytes))), "test.y4m".into())
}

/// The chroma kinds: tag, planes' sizes for a picture, and the samples of the reference.
fn samples<'a>(tag: &str, size: Size, bytes: &'a [u8]) -> Samples<'a> {
    let half = Size::new(size.width.div_ceil(2), size.height.div_ceil(2));
    let chroma = match tag {
        "C422" => Size::new(half.width, size.height),
        "C444" => size,
        _ => half,
    };
    let plane = |from: usize, size: Size| PlaneRef::new(&bytes[from..], size, size.width).expect("fits");
    if tag == "Cmono" {
        return Samples::Gray(plane(0, size));
    }
    let planes = [plane(0, size), plane(size.area(), chroma), plane(size.area() + chroma.area(), chroma)];
    match tag {
        "C422" => Samples::Planar422(planes),
        "C444" => Samples::Planar444(planes),
        "C420mpeg2" => Samples::Planar420(planes, Siting::Left),
        "C420paldv" => Samples::Planar420(planes, Siting::PalDv),
        _ => Samples::Planar420(planes, Siting::Center),
    }
}

fn bytes_of(tag: &str, size: Size) -> usize {
    let half = Size::new(size.width.div_ceil(2), size.height.div_ceil(2));
    match tag {
        "Cmono" => size.area(),
        "C422" => size.area() + 2 * half.width * size.height,
        "C444" => 3 * size.area(),
        _ => size.area() + 2 * half.area(),
    }
}

const TAGS: [&str; 8] = ["", "C420", "C420jpeg", "C420mpeg2", "C420paldv", "C422", "C444", "Cmono"];

#[test]
fn y4m_of_every_kind_and_odd_sizes_matches_the_reference() {
    for tag in TAGS {
        for (extra, range) in [
            ("", Range::Limited),
            (" XCOLORRANGE=FULL", Range::Full),
            (" XCOLORRANGE=LIMITED", Range::Limited),
        ] {
            for (w, h) in [(1, 1), (2, 2), (3, 5), (7, 4), (64, 33)] {
                let size = Size::new(w, h);
                let (clip, pictures) = y4m(&format!("{tag}{extra}"), size, bytes_of(tag, size), 3);
                let mut clip = open(clip).expect("a clip");
                assert_eq!((clip.size(), clip.fps()), (size, 25.0));
                let mut frame = Frame::default();
                for (i, bytes) in pictures.iter().enumerate() {
                    assert_eq!(clip.next(&mut frame).expect("a frame"), Grab::Frame);
                    assert_eq!(frame.sequence, i as u64);
                    assert_eq!(frame.captured_at, Duration::from_millis(40 * i as u64));
                    let coding = Coding { matrix: Matrix::Bt601, range };
                    let (luma, color) = reference::to_rgb(&samples(tag, size, bytes), size, coding);
                    assert!(frame.luma == luma, "{tag}{extra} {size}: luma");
                    for c in 0..3 {
                        for y in 0..h {
                            for x in 0..w {
                                let (got, wanted) =
                                    (frame.color.planes[c].at(x, y), color.planes[c].at(x, y));
                                assert!(got.abs_diff(wanted) <= 1, "{tag}{extra} {size} at {x},{y}");
                            }
                        }
                    }
                }
                assert_eq!(clip.next(&mut frame).expect("the end"), Grab::End);
            }
        }
    }
}

#[test]
fn a_y4m_cut_anywhere_is_an_error_that_names_the_frame() {
    let size = Size::new(5, 3);
    let (whole, _) = y4m("C420jpeg", size, bytes_of("C420jpeg", size), 2);
    let header = whole.iter().position(|&b| b == b'\n').expect("a header") + 1;
    let frame_bytes = (whole.len() - header) / 2;
    for cut in 0..whole.len() {
        let bytes = whole[..cut].to_vec();
        let clip = open(bytes);
        if cut < header {
            let error = clip.err().expect("no header").to_string();
            assert!(error.contains("test.y4m"), "{error}");
            continue;
        }
        let (mut clip, mut frame) = (clip.expect("a header"), Frame::default());
        let whole_frames = (cut - header) / frame_bytes;
        for _ in 0..whole_frames {
            assert_eq!(clip.next(&mut frame).expect("a whole frame"), Grab::Frame);
        }
        if (cut - header) % frame_bytes == 0 {
            assert_eq!(clip.next(&mut frame).expect("the end"), Grab::End);
        } else {
            let error = clip.next(&mut frame).expect_err("cut").to_string();
            assert!(
                error.contains("test.y4m") && error.contains(&format!("frame {whole_frames}")),
                "{error}"
            );
        }
    }
}

#[test]
fn hostile_y4m_headers_are_refused_by_name() {
    let table = [
        ("RIFF....", "not a Y4M clip"),
        ("YUV4MPEG2 W4 H4 It\n", "interlaced"),
        ("YUV4MPEG2 W4 H4 C420p10\n", "C420p10"),
        ("YUV4MPEG2 W4 H4 C411\n", "C411"),
        ("YUV4MPEG2 W0 H4\n", "0x4"),
        ("YUV4MPEG2 W4\n", "4x0"),
        ("YUV4MPEG2 W99999 H4\n", "99999x4"),
        ("YUV4MPEG2 W4294967297 H4294967297\n", "over 8192x8192"),
        ("YUV4MPEG2 W-4 H4\n", "W-4"),
        ("YUV4MPEG2 W4 H4 F30\n", "F30"),
        ("YUV4MPEG2 W4 H4 F30:-1\n", "F30:-1"),
        ("YUV4MPEG2 W\u{fc}4 H4\n", "no number"),
    ];
    for (header, part) in table {
        let error = open(header.as_bytes().to_vec()).err().expect(header).to_string();
        assert!(error.contains(part) && error.contains("test.y4m"), "{header:?}: {error}");
    }
    let long = format!("YUV4MPEG2 W4 H4 X{}\n", "x".repeat(5000));
    assert!(open(long.into_bytes()).is_err(), "the header length is bounded");
    let mut clip = open(b"YUV4MPEG2 W8192 H8192 C444\nFRAME\nabc".to_vec()).expect("a header");
    let error = clip.next(&mut Frame::default()).expect_err("cut").to_string();
    assert!(error.contains("frame 0"), "{error}");
    let mut clip = open(b"YUV4MPEG2 W2 H2 Cmono\nFRUME\nabcd".to_vec()).expect("a header");
    let error = clip.next(&mut Frame::default()).expect_err("damaged").to_string();
    assert!(error.contains("frame 0 does not begin with FRAME"), "{error}");
    let mut clip = open(b"YUV4MPEG2 W2 H2 F0:0 Cmono\n".to_vec()).expect("an unknown rate and no frames");
    assert_eq!(clip.next(&mut Frame::default()).expect("empty"), Grab::End);
}

#[test]
fn a_folder_is_read_in_name_order_and_sizes_may_differ() {
    let path = folder("order");
    for (name, w, gray) in [("b.png", 3, 20), ("a10.png", 2, 10), ("c.PNG", 5, 30)] {
        picture::write_png(&path.join(name), &Rgb::new(Size::new(w, 2), [gray, gray, gray]))
            .expect("written");
    }
    std::fs::write(path.join("a.pgm"), b"P5 4 1 255\n\x01\x02\x03\x04").expect("written");
    std::fs::write(path.join("notes.txt"), "not a picture").expect("written");
    let mut source = Source::open(&Config { fps: 10.0, ..Config::clip(&path) }).expect("a folder");
    source.keep_raw(true);
    let (mut frame, mut seen) = (Frame::default(), Vec::new());
    while source.next(&mut frame, NOW).expect("pictures") == Grab::Frame {
        assert_eq!(source.size(), frame.size());
        assert_eq!(frame.color.size(), frame.size());
        seen.push((frame.luma.at(0, 0), frame.size().width, frame.captured_at.as_millis()));
        let mut again = Frame::default();
        camera::decode(&source.raw().expect("kept"), &mut again).expect("decodes");
        assert!(again.luma == frame.luma && again.color == frame.color, "raw pictures replay");
    }
    assert_eq!(seen, [(1, 4, 0), (10, 2, 100), (20, 3, 200), (30, 5, 300)]);
    assert_eq!(source.stats().delivered, 4);
}

#[test]
fn a_broken_picture_is_an_error_and_the_folder_goes_on() {
    let path = folder("broken");
    picture::write_png(&path.join("a.png"), &Rgb::new(Size::new(4, 4), [1, 2, 3])).expect("written");
    let whole = std::fs::read(path.join("a.png")).expect("read");
    std::fs::write(path.join("b.png"), &whole[..whole.len() / 2]).expect("written");
    std::fs::write(path.join("c.png"), &whole).expect("written");
    let (mut clip, mut frame) = (Clip::open(&path, 30.0).expect("a folder"), Frame::default());
    assert_eq!(clip.next(&mut frame).expect("a.png"), Grab::Frame);
    let error = clip.next(&mut frame).expect_err("b.png").to_string();
    assert!(error.contains("b.png"), "{error}");
    assert_eq!(clip.next(&mut frame).expect("c.png"), Grab::Frame);
    assert!(clip.file().is_some_and(|file| file.ends_with("c.png")));
    assert_eq!(clip.next(&mut frame).expect("the end"), Grab::End);
}

#[test]
fn missing_things_are_named_with_what_to_do() {
    let missing = |config: Config| Source::open(&config).err().expect("nothing there").to_string();
    let error = missing(Config { device: "/dev/video-none".into(), ..Config::default() });
    assert!(error.contains("no camera at /dev/video-none") && error.contains("camera.device"), "{error}");
    let error = missing(Config { device: "/dev/null".into(), ..Config::default() });
    assert!(error.contains("/dev/null cannot serve"), "{error}");
    let error = missing(Config { device: "/dev/\0".into(), ..Config::default() });
    assert!(!error.is_empty());
    let error = missing(Config::clip("/nowhere/clip.y4m"));
    assert!(error.contains("/nowhere/clip.y4m"), "{error}");
    let error = missing(Config::clip(""));
    assert!(error.contains("camera.path"), "{error}");
    let error = missing(Config::clip(folder("empty")));
    assert!(error.contains("holds no pictures"), "{error}");
    let error =
        missing(Config { source: Kind::Trace, path: "/nowhere/run.trace".into(), ..Config::default() });
    assert!(error.contains("/nowhere/run.trace"), "{error}");
}

#[test]
fn the_configuration_refuses_unknown_keys() {
    let good: Config =
        toml::from_str("source = \"clip\"\npath = \"x.y4m\"\nformat = \"nv12\"").expect("good");
    assert_eq!((good.source, good.format.name(), good.width), (Kind::Clip, "nv12", 640));
    let error = toml::from_str::<Config>("devise = \"x\"").expect_err("unknown").to_string();
    assert!(error.contains("devise"), "{error}");
    assert!(toml::from_str::<Config>("format = \"h264\"").is_err());
}

#[test]
fn offers_are_ranked_by_size_then_speed_then_format() {
    let offer = |format, w, h, fps| Offer { format, size: Size::new(w, h), fps };
    let offers = [
        offer(PixelFormat::Mjpg, 640, 480, Some(30.0)),
        offer(PixelFormat::Grey, 640, 480, Some(60.0)),
        offer(PixelFormat::Yuyv, 1280, 720, Some(30.0)),
        offer(PixelFormat::Yuyv, 640, 480, Some(15.0)),
        offer(PixelFormat::Nv12, 640, 480, None),
    ];
    let wish = Wish { size: Size::new(640, 480), fps: 30.0, format: None };
    let order: Vec<_> = rank(&offers, &wish).iter().map(|r| (r.offer.format, r.offer.size.width)).collect();
    use PixelFormat::*;
    assert_eq!(order, [(Nv12, 640), (Mjpg, 640), (Grey, 640), (Yuyv, 640), (Yuyv, 1280)]);
    let slow = rank(&offers, &Wish { fps: 15.0, ..wish });
    assert_eq!(slow[0].offer.format, Yuyv);
    assert_eq!(slow[0].reason, "yuyv 640x480 (as wished), 15.0/s, luma as it is, chroma on every row");
    let large = rank(&offers, &Wish { size: Size::new(1280, 720), ..wish });
    assert_eq!(large[0].offer.size, Size::new(1280, 720));
    let only = rank(&offers, &Wish { format: Some(Mjpg), ..wish });
    assert_eq!((only.len(), only[0].offer.format), (1, Mjpg));
    assert!(rank(&offers, &Wish { format: Some(Uyvy), ..wish }).is_empty());
    assert!(rank(&[], &wish).is_empty());
}

#[test]
fn a_drivers_answer_becomes_the_raw_format() {
    let yuyv = u32::from_le_bytes(*b"YUYV");
    let base = Granted { width: 640, height: 480, fourcc: yuyv, bytes_per_line: 1344, ..Granted::default() };
    let raw = granted("cam", &base).expect("fine");
    assert_eq!((raw.format, raw.size, raw.stride), (PixelFormat::Yuyv, Size::new(640, 480), 1344));
    assert_eq!(raw.coding, Coding::default(), "nothing said: limited BT.601");
    assert_eq!(raw.least_bytes(), Some(1344 * 479 + 1280));
    let bad = [
        Granted { bytes_per_line: 1279, ..base },
        Granted { width: 0, ..base },
        Granted { height: 9000, ..base },
        Granted { bytes_per_line: u32::MAX, ..base },
        Granted { fourcc: u32::from_le_bytes(*b"H264"), ..base },
    ];
    for answer in bad {
        let error = granted("cam", &answer).expect_err("refused").to_string();
        assert!(error.starts_with("cam cannot serve"), "{error}");
    }
    let of = |colorspace, encoding, quantization| {
        let c = coding(PixelFormat::Yuyv, colorspace, encoding, quantization);
        (c.matrix, c.range)
    };
    assert_eq!(of(8, 0, 0), (Matrix::Bt601, Range::Limited), "sRGB");
    assert_eq!(of(3, 0, 0), (Matrix::Bt709, Range::Limited), "Rec. 709");
    assert_eq!(of(3, 1, 1), (Matrix::Bt601, Range::Full), "the driver's word counts more");
    assert_eq!(of(7, 0, 0), (Matrix::Bt601, Range::Full), "JPEG");
    assert_eq!(of(10, 0, 2), (Matrix::Bt2020, Range::Limited));
    assert_eq!(of(99, 99, 99), (Matrix::Bt601, Range::Limited), "numbers of the future");
    assert_eq!(coding(PixelFormat::Rgb3, 8, 0, 0).range, Range::Full);
    assert_eq!(coding(PixelFormat::Grey, 8, 0, 0).range, Range::Limited);
}

/// Writes a trace of three frames of three formats; gives the frames and the entries.
fn trace(path: &Path) -> (Vec<Frame>, Vec<Entry>) {
    let mut writer = Writer::create(path).expect("created");
    let (mut frames, mut entries) = (Vec::new(), Vec::new());
    let kinds = [(PixelFormat::Yuyv, 5, 3), (PixelFormat::Nv12, 4, 5), (PixelFormat::Rgb3, 3, 2)];
    for (i, (format, w, h)) in kinds.into_iter().enumerate() {
        let mut raw = RawFormat::new(format, Size::new(w, h));
        raw.stride += i;
        raw.coding = Coding { matrix: Matrix::Bt709, range: Range::Full };
        let bytes = noise(raw.least_bytes().expect("within bounds") + 3, i as u64);
        let raw = RawRef { format: raw, bytes: &bytes };
        let entry = Entry {
            sequence: 7 + 2 * i as u64,
            captured_at: Duration::from_millis(33 * i as u64 + 1),
            shown_at: Duration::from_millis(33 * i as u64 + 20),
            shown_hash: 0x0123_4567_89ab_cdef + i as u64,
            mode: [640, 480],
        };
        let mut frame =
            Frame { sequence: entry.sequence, captured_at: entry.captured_at, ..Frame::default() };
        camera::decode(&raw, &mut frame).expect("decodes");
        writer.push(&entry, &raw).expect("written");
        frames.push(frame);
        entries.push(entry);
    }
    writer.finish().expect("flushed");
    (frames, entries)
}

#[test]
fn a_trace_replays_the_same_frames() {
    let path = folder("trace").join("run.trace");
    let (frames, entries) = trace(&path);
    let config = Config { source: Kind::Trace, path, ..Config::default() };
    let mut source = Source::open(&config).expect("a trace");
    let mut frame = Frame::default();
    for (wanted, entry) in frames.iter().zip(&entries) {
        assert_eq!(source.size(), wanted.size());
        assert_eq!(source.next(&mut frame, NOW).expect("a frame"), Grab::Frame);
        assert!(frame.luma == wanted.luma && frame.color == wanted.color);
        assert_eq!((frame.sequence, frame.captured_at), (wanted.sequence, wanted.captured_at));
        let Source::Trace(trace) = &source else { panic!("a trace") };
        assert_eq!((trace.entry(), trace.shown_hash()), (Some(entry), Some(entry.shown_hash)));
        assert!(source.raw().is_some());
    }
    assert_eq!(source.next(&mut frame, NOW).expect("the end"), Grab::End);
}

#[test]
fn a_cut_or_damaged_trace_is_refused_by_frame() {
    let path = folder("trace-cut").join("run.trace");
    trace(&path);
    let whole = std::fs::read(&path).expect("read");
    let (cut_path, mut frame) = (path.with_file_name("cut.trace"), Frame::default());
    let replay = |bytes: &[u8], frame: &mut Frame| -> Result<usize, String> {
        std::fs::write(&cut_path, bytes).expect("written");
        let config = Config { source: Kind::Trace, path: cut_path.clone(), ..Config::default() };
        let mut source = Source::open(&config).map_err(|e| e.to_string())?;
        let mut count = 0;
        while source.next(frame, NOW).map_err(|e| e.to_string())? == Grab::Frame {
            count += 1;
        }
        Ok(count)
    };
    assert_eq!(replay(&whole, &mut frame), Ok(3));
    let mut ends = 0;
    for cut in 0..whole.len() {
        match replay(&whole[..cut], &mut frame) {
            Ok(_) => ends += 1,
            Err(error) => assert!(error.contains("cut.trace"), "{error}"),
        }
    }
    assert_eq!(ends, 3, "after the magic, the first and the second frame");
    for i in 0..92 {
        for value in [0, 1, 0x7f, 0xff] {
            let mut bytes = whole.clone();
            bytes[i] = value;
            let _ = replay(&bytes, &mut frame);
        }
    }
}

#[test]
fn raw_bytes_are_never_read_out_of_bounds() {
    let mut frame = Frame::default();
    for format in PixelFormat::ALL {
        for (w, h) in [(1, 1), (3, 3), (16, 7)] {
            let raw = RawFormat::new(format, Size::new(w, h));
            let least = raw.least_bytes().expect("within bounds");
            let bytes = noise(least, 1);
            for n in 0..=least.min(200) {
                let decoded = camera::decode(&RawRef { format: raw, bytes: &bytes[..n] }, &mut frame);
                assert_eq!(
                    decoded.is_ok(),
                    n == least && format != PixelFormat::Mjpg,
                    "{format} {w}x{h} of {n}"
                );
            }
        }
        for (w, h, stride) in [(0, 4, 4), (4, 0, 4), (9000, 4, 40_000), (8, 8, usize::MAX), (8, 8, 0)] {
            let raw = RawFormat { stride, ..RawFormat::new(format, Size::new(w, h)) };
            let decoded = camera::decode(&RawRef { format: raw, bytes: &[0; 4096] }, &mut frame);
            let planar = matches!(format, PixelFormat::Yuv420 | PixelFormat::Yuv422 | PixelFormat::Yuv444);
            assert!(decoded.is_err() || (planar && w == 8), "{format} {w}x{h} stride {stride}");
        }
    }
}

/// The photograph as JPEG, as a camera would send it.
fn jpeg() -> (Vec<u8>, Size) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/filters/micro_coffee_160x120.png");
    let picture = image::open(path).expect("the photograph").into_rgb8();
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 90)
        .encode_image(&picture)
        .expect("encoded");
    (bytes, Size::new(picture.width() as usize, picture.height() as usize))
}

#[test]
fn mjpeg_is_full_range_and_near_another_decoder() {
    let (bytes, size) = jpeg();
    let raw = RawRef { format: RawFormat::new(PixelFormat::Mjpg, size), bytes: &bytes };
    let mut frame = Frame::default();
    camera::decode(&raw, &mut frame).expect("decodes");
    let other = image::load_from_memory(&bytes).expect("decodes").into_rgb8();
    let mut worst = 0;
    for y in 0..size.height {
        for x in 0..size.width {
            let p = other.get_pixel(x as u32, y as u32).0;
            for (a, b) in frame.color.at(x, y).into_iter().zip(p) {
                worst = worst.max(a.abs_diff(b));
            }
        }
    }
    assert!(worst <= 2, "off by {worst} levels");
}

#[test]
fn damaged_mjpeg_never_panics_and_keeps_the_frame() {
    let (whole, size) = jpeg();
    let format = RawFormat::new(PixelFormat::Mjpg, size);
    let mut frame = Frame::default();
    let mut good = Frame::default();
    camera::decode(&RawRef { format, bytes: &whole }, &mut good).expect("decodes");
    let mut rng = SplitMix64::new(1);
    for i in 0..600 {
        let mut bytes = whole.clone();
        if i < 200 {
            bytes.truncate(rng.int(0, whole.len() as i64 - 3) as usize);
        } else {
            for _ in 0..rng.int(1, 8) {
                let at = rng.int(0, whole.len() as i64 - 1) as usize;
                bytes[at] = rng.next_u64() as u8;
            }
        }
        frame.luma = good.luma.clone();
        let decoded = camera::decode(&RawRef { format, bytes: &bytes }, &mut frame);
        if decoded.is_err() {
            assert!(frame.luma == good.luma, "a refused picture leaves the frame alone");
        }
    }
    let other = RawFormat::new(PixelFormat::Mjpg, Size::new(80, 60));
    assert!(camera::decode(&RawRef { format: other, bytes: &whole }, &mut frame).is_err(), "another size");
}
