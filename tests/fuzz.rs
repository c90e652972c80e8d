//! Everything that comes from outside, harmed: no parser panics, none takes long.
//!
//! Good bytes are mutated at random, the same way on every machine, and given to the parser; any result is good if it
//! comes within [`LONGEST`]. Model files have tests of their own (`tests/loaders`), as has a button line that breaks
//! (`tests/bad_line.rs`). `VERNISSAGE_SOAK=1` tries twenty times as many; every test prints how many it tried.

#[path = "common/mutate.rs"]
mod mutate;

use image::{DynamicImage, ImageFormat, RgbImage};
use mutate::mutate;
use rustix::time::{ClockId, clock_gettime};
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::time::Duration;
use vernissage::app::config::Config;
use vernissage::buttons::Wire;
use vernissage::camera::negotiate::{Granted, Offer, Wish, granted, rank};
use vernissage::camera::{Clip, Decoder, Grab, PixelFormat, RawFormat, RawRef, Trace, trace};
use vernissage::frame::Frame;
use vernissage::marker::Patterns;
use vernissage::pixels::{Size, SplitMix64};

/// No small input may take longer.
const LONGEST: Duration = Duration::from_millis(100);

fn soak(count: u64) -> u64 {
    if std::env::var_os("VERNISSAGE_SOAK").is_some() { 20 * count } else { count }
}

/// The processor's time that the parser takes: a busy machine may stop it at any time.
fn took(parse: impl FnOnce()) -> Duration {
    let now = || {
        let time = clock_gettime(ClockId::ThreadCPUTime);
        Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
    };
    let start = now();
    parse();
    now() - start
}

/// Tries `count` mutations of each of the `good` inputs.
fn fuzz(name: &str, good: &[Vec<u8>], count: u64, mut parse: impl FnMut(&[u8])) {
    let count = soak(count);
    let mut rng = SplitMix64::new(20);
    let (mut bytes, mut slowest) = (Vec::new(), Duration::ZERO);
    for good in good {
        parse(good);
        for _ in 0..count {
            bytes.clone_from(good);
            mutate(&mut bytes, &mut rng);
            let took = took(|| parse(&bytes));
            assert!(took <= LONGEST, "{name}: {took:?} for {:?}", String::from_utf8_lossy(&bytes));
            slowest = slowest.max(took);
        }
    }
    println!("{name}: {} inputs, slowest {slowest:?}", good.len() as u64 * (count + 1));
}

/// A picture with something in it.
fn picture(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| image::Rgb([(x * 9) as u8, (x * y) as u8, (y * 31) as u8]))
}

fn encoded(picture: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, format).expect("encoded");
    bytes.into_inner()
}

/// Where this process may leave files.
fn folder() -> PathBuf {
    let folder = std::env::temp_dir().join(format!("vernissage-fuzz-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("temporary folder");
    folder
}

#[test]
fn camera_pictures() {
    let color = DynamicImage::from(picture(48, 32));
    let gray = DynamicImage::from(color.to_luma8());
    let good = [encoded(&color, ImageFormat::Jpeg), encoded(&gray, ImageFormat::Jpeg)];
    let (mut decoder, mut frame) = (Decoder::default(), Frame::default());
    let format = RawFormat::new(PixelFormat::Mjpg, Size::new(48, 32));
    decoder.decode(&RawRef { format, bytes: &good[0] }, &mut frame).expect("a whole picture");
    let mut before = frame.clone();
    fuzz("MJPEG", &good, 10_000, |bytes| {
        if decoder.decode(&RawRef { format, bytes }, &mut frame).is_err() {
            assert!(frame.color == before.color, "an error leaves the last picture");
        } else {
            before.clone_from(&frame);
        }
        assert_eq!(frame.size(), Size::new(48, 32));
    });
}

#[test]
fn answers_of_camera_drivers() {
    let mut rng = SplitMix64::new(21);
    let (mut decoder, mut frame) = (Decoder::default(), Frame::default());
    let codes = [*b"YUYV", *b"UYVY", *b"NV12", *b"GREY", *b"RGB3", *b"MJPG", *b"JPEG", *b"H264"];
    let bytes: Vec<u8> = (0..6000u32).map(|i| (i * 7) as u8).collect();
    let count = soak(250_000);
    let mut taken = 0;
    for _ in 0..count {
        let mut number = |most: i64| match rng.int(0, 9) {
            0 => rng.next_u64() as u32,
            1 => [0, 1, u32::MAX, 1 << 31, 8192, 8193][rng.int(0, 5) as usize],
            _ => rng.int(0, most) as u32,
        };
        let answer = Granted {
            width: number(64),
            height: number(48),
            fourcc: number(codes.len() as i64 - 1),
            bytes_per_line: number(200),
            colorspace: number(12),
            encoding: number(8),
            quantization: number(3),
        };
        let named = codes.get(answer.fourcc as usize).map(|code| u32::from_le_bytes(*code));
        let answer = Granted { fourcc: named.unwrap_or(answer.fourcc), ..answer };
        let offer = |fps| Offer {
            format: PixelFormat::ALL[answer.encoding as usize % 9],
            size: Size::new(answer.width as usize, answer.height as usize),
            fps,
        };
        let rate = f64::from_bits(rng.next_u64());
        let offers = [offer(Some(rate)), offer(None), offer(Some(30.0))];
        let wish =
            Wish { size: Size::new(640, 480), fps: if rate > 0.0 { rate } else { 30.0 }, format: None };
        assert_eq!(rank(&offers, &wish).len(), 3);
        let took = took(|| {
            let Ok(format) = granted("camera", &answer) else { return };
            taken += 1;
            // a driver may say any length
            let length = (rng.next_u64() % 6001) as usize;
            let bytes = &bytes[..length];
            let drawn = decoder.decode(&RawRef { format, bytes }, &mut frame);
            assert!(drawn.is_err() || frame.size() == format.size);
        });
        assert!(took <= LONGEST, "{took:?} for {answer:?}");
    }
    println!("driver answers: {count} inputs, {taken} fit to be decoded");
    assert!(taken > count / 4);
}

#[test]
fn clips() {
    let mut good = Vec::new();
    for (chroma, bytes) in
        [("420jpeg", 12 * 10 * 3 / 2), ("422", 240), ("444 XCOLORRANGE=FULL", 360), ("mono", 120)]
    {
        let mut clip = format!("YUV4MPEG2 W12 H10 F30:1 Ip A1:1 C{chroma}\n").into_bytes();
        for frame in 0..2 {
            clip.extend_from_slice(b"FRAME\n");
            clip.extend((0..bytes).map(|i| (i * (3 + frame)) as u8));
        }
        good.push(clip);
    }
    let mut frame = Frame::default();
    fuzz("Y4M", &good, 12_500, |bytes| {
        let Ok(mut clip) = Clip::y4m(Box::new(Cursor::new(bytes.to_vec())), "clip".into()) else { return };
        for _ in 0..4 {
            if !matches!(clip.next(&mut frame), Ok(Grab::Frame)) {
                break;
            }
        }
    });
}

#[test]
fn traces() {
    let path = folder().join("trace");
    let mut writer = trace::Writer::create(&path).expect("trace");
    let bytes: Vec<u8> = (0..16 * 6 * 2).map(|i| i as u8).collect();
    let raw = RawRef { format: RawFormat::new(PixelFormat::Yuyv, Size::new(16, 6)), bytes: &bytes };
    for sequence in 0..3 {
        writer.push(&trace::Entry { sequence, mode: [640, 480], ..Default::default() }, &raw).expect("frame");
    }
    writer.finish().expect("written");
    let good = [std::fs::read(&path).expect("read back")];
    let mut frame = Frame::default();
    fuzz("traces", &good, 2_500, |bytes| {
        std::fs::write(&path, bytes).expect("temporary file");
        let Ok(mut trace) = Trace::open(&path) else { return };
        for _ in 0..5 {
            if !matches!(trace.next(&mut frame), Ok(Grab::Frame)) {
                break;
            }
        }
    });
}

#[test]
fn settings() {
    let board = Path::new(env!("CARGO_MANIFEST_DIR")).join("board");
    let mut good: Vec<Vec<u8>> = ["laptop", "rpi4", "rpi5", "virtual"]
        .map(|name| std::fs::read(board.join(name).with_extension("toml")).expect(name))
        .to_vec();
    good.push(
        br#"[camera]
source = "synthetic"
width = 320
height = 240
[lens]
width = 320
height = 240
fx = 400.0
fy = 400.0
cx = 160.0
cy = 120.0
dist = [0.1, -0.2, 0.0, 0.0, 0.0]
[[model]]
file = "teapot"
marker = { family = "tag36h11", id = 7, side_mm = 80 }
rotate_deg = [0, 0, -25]
[[board]]
side_mm = 40
prints = [{ id = 0, at_mm = [0, 0, 0] }, { id = 1, at_mm = [60, 0, 0], rotate_deg = [0, 90, 0] }]
[style]
name = "sketchy"
cycle = ["cartoon", "sketchy"]
[style.sketchy]
threshold = 0.2
"#
        .to_vec(),
    );
    fuzz("settings", &good, 2_500, |bytes| {
        let text = String::from_utf8_lossy(bytes);
        if let Err(error) = Config::parse(&text, Path::new("visor.toml")) {
            let text = error.to_string();
            assert!(text.contains("visor.toml") && !text.trim().is_empty(), "{text}");
        }
    });
}

#[test]
fn picture_markers() {
    let path = folder().join("mark.patt");
    let good: String = (0..12 * 16)
        .map(|row| (0..16).map(|x| format!("{:4}", (row * 37 + x * x * 11) % 256)).collect::<String>() + "\n")
        .collect();
    fuzz("patterns", &[good.into_bytes()], 2_500, |bytes| {
        std::fs::write(&path, bytes).expect("temporary file");
        if let Err(error) = Patterns::default().load(&path, Patterns::LEAST_MATCH) {
            assert!(error.to_string().contains("mark.patt"), "{error}");
        }
    });
}

#[test]
fn messages_of_button_boards() {
    let bodies =
        ["HELLO 1 5F3A01C2 1.4.0 3 1 0003", "BTN 1 D 48213", "BTN 1 U 48377", "STATE 0 118 49000", "ACK 01"];
    let framed = |body: &str| vernissage::buttons::frame(1, &body);
    let mut session: Vec<u8> = bodies.iter().flat_map(|body| framed(body).into_bytes()).collect();
    session.extend_from_slice(b"help\r\nstatus\n");
    let heard = |bytes: &[u8]| {
        let mut wire = Wire::default();
        bytes.iter().filter(|&&byte| wire.push(byte).is_some()).count()
    };
    assert_eq!(heard(&session), bodies.len() + 2);
    fuzz("button lines", &[session], 100_000, |bytes| {
        assert!(heard(bytes) <= bytes.len());
    });
    // with a checksum that holds, so that the words themselves are read
    let good = bodies.map(|body| body.as_bytes().to_vec());
    fuzz("button messages", &good, 30_000, |bytes| {
        assert!(heard(framed(&String::from_utf8_lossy(bytes)).as_bytes()) <= bytes.len() + 1);
    });
}
