//! Calibration YAML as others write it: OpenCV's FileStorage and ROS's camera_info, also as a printed message.
//!
//! Bounded: 64 kB of text (the caller's limit), so many nodes, so deep. Aliases are refused, unknown keys passed over.

use super::{LensConfig, LensError};
use saphyr_parser::{Event, Parser};

/// Most nodes of a file.
const MOST_NODES: usize = 4096;
/// Deepest nesting.
const DEEPEST: usize = 8;

/// A node and its line.
#[derive(Debug)]
struct Node {
    line: usize,
    value: Value,
}

#[derive(Debug)]
enum Value {
    Word(String),
    List(Vec<Node>),
    Map(Vec<(String, Node)>),
}

/// The calibration in a text.
pub fn read(text: &str) -> Result<LensConfig, LensError> {
    let root = tree(text)?;
    let Value::Map(keys) = &root.value else {
        return wrong(root.line, "not a calibration: no keys such as camera_matrix");
    };
    let find = |names: &[&str]| keys.iter().find(|(key, _)| names.contains(&key.as_str())).map(|(_, n)| n);
    let need = |names: &[&str]| match find(names) {
        Some(node) => Ok(node),
        None => wrong(root.line, &format!("no {}: not a calibration of OpenCV or ROS", names[0])),
    };
    if let Some(model) = find(&["distortion_model"])
        && let Value::Word(word) = &model.value
        && !["plumb_bob", "rational_polynomial", "radtan", "none", ""].contains(&word.as_str())
    {
        let reason = format!("distortion_model {word} is not ours: calibrate with `vernissage calibrate`");
        return wrong(model.line, &reason);
    }
    let side = |names: &[&str]| {
        let node = need(names)?;
        let value = number(node)?;
        if (1.0..=65536.0).contains(&value) && value.fract() == 0.0 {
            Ok(value as usize)
        } else {
            wrong(node.line, &format!("{} is {value}: a whole number of pixels is meant", names[0]))
        }
    };
    let camera = need(&["camera_matrix", "Camera_Matrix", "K", "k"])?;
    let matrix = numbers(camera)?;
    let [fx, skew, cx, zero, fy, cy, a, b, one] = matrix[..] else {
        return wrong(camera.line, &format!("camera_matrix has {} numbers, not 9", matrix.len()));
    };
    if [skew, zero, a, b] != [0.0; 4] || one != 1.0 {
        return wrong(camera.line, "camera_matrix is not [fx 0 cx, 0 fy cy, 0 0 1]");
    }
    let keys = &["distortion_coefficients", "Distortion_Coefficients", "D", "d"];
    let mut dist = match find(keys) {
        Some(node) => numbers(node)?,
        None => Vec::new(),
    };
    // OpenCV's longer forms end with terms of thin prisms and tilted sensors
    if dist.len() > 8 && dist[8..].iter().all(|k| *k == 0.0) {
        dist.truncate(8);
    }
    if ![0, 4, 5, 8].contains(&dist.len()) {
        let line = find(keys).map_or(1, |node| node.line);
        return wrong(line, &format!("{} distortion coefficients: 4, 5 or 8 are understood", dist.len()));
    }
    Ok(LensConfig {
        file: None,
        width: side(&["image_width", "width"])?,
        height: side(&["image_height", "height"])?,
        fx,
        fy,
        cx,
        cy,
        dist,
    })
}

fn wrong<T>(line: usize, reason: &str) -> Result<T, LensError> {
    Err(LensError { line, reason: reason.into() })
}

fn number(node: &Node) -> Result<f64, LensError> {
    let Value::Word(word) = &node.value else { return wrong(node.line, "a number is meant here") };
    match word.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => {
            let word: String = word.chars().take(40).filter(|c| !c.is_control()).collect();
            wrong(node.line, &format!("{word:?} is not a finite number"))
        }
    }
}

/// The numbers of a list, or of the `data` of a matrix whose rows and columns must agree.
fn numbers(node: &Node) -> Result<Vec<f64>, LensError> {
    match &node.value {
        Value::List(list) => {
            let rows = list.iter().map(|node| match node.value {
                // a list of rows
                Value::List(_) => numbers(node),
                _ => Ok(vec![number(node)?]),
            });
            Ok(rows.collect::<Result<Vec<_>, _>>()?.concat())
        }
        Value::Map(keys) => {
            let find = |name: &str| keys.iter().find(|(key, _)| key == name).map(|(_, node)| node);
            let Some(data) = find("data") else { return wrong(node.line, "a matrix without data") };
            let values = numbers(data)?;
            if let (Some(rows), Some(columns)) = (find("rows"), find("cols")) {
                let count = number(rows)? * number(columns)?;
                if count != values.len() as f64 {
                    return wrong(data.line, &format!("{} numbers, rows x cols say {count}", values.len()));
                }
            }
            Ok(values)
        }
        Value::Word(_) => wrong(node.line, "a list of numbers is meant here"),
    }
}

/// The first document of a text.
fn tree(text: &str) -> Result<Node, LensError> {
    // OpenCV's first line is a directive of its own making
    let own = text.trim_start_matches('\u{feff}');
    let text = match own.strip_prefix('%') {
        Some(rest) => format!("#{rest}"),
        None => own.to_string(),
    };
    // what is open: its line, what is in it so far, and in a map the key that waits for its value
    let mut open: Vec<(usize, Value, Option<String>)> = Vec::new();
    let mut nodes = 0;
    for event in Parser::new_from_str(&text) {
        let (event, span) = event.map_err(|e| {
            let reason: String = e.info().chars().filter(|c| !c.is_control()).take(120).collect();
            LensError { line: e.marker().line().max(1), reason: format!("not YAML: {reason}") }
        })?;
        let line = span.start.line().max(1);
        let done = match event {
            Event::Alias(_) => return wrong(line, "aliases (*name) have no place in a calibration"),
            Event::Scalar(word, ..) => Node { line, value: Value::Word(word.into_owned()) },
            Event::SequenceStart(..) | Event::MappingStart(..) => {
                if open.len() == DEEPEST {
                    return wrong(line, "nested too deep for a calibration");
                }
                let is_map = matches!(event, Event::MappingStart(..));
                open.push((
                    line,
                    if is_map { Value::Map(Vec::new()) } else { Value::List(Vec::new()) },
                    None,
                ));
                continue;
            }
            Event::SequenceEnd | Event::MappingEnd => match open.pop() {
                Some((line, value, _)) => Node { line, value },
                None => return wrong(line, "an end without a beginning"),
            },
            Event::DocumentEnd | Event::StreamEnd => break,
            Event::Nothing | Event::StreamStart | Event::DocumentStart(_) => continue,
        };
        nodes += 1;
        if nodes > MOST_NODES {
            return wrong(line, "too long for a calibration");
        }
        let Some((_, value, waiting)) = open.last_mut() else { return Ok(done) };
        match (value, waiting.take()) {
            (Value::List(list), _) => list.push(done),
            (Value::Map(keys), Some(key)) => {
                if keys.iter().any(|(other, _)| *other == key) {
                    return wrong(line, &format!("{key:?} is there twice"));
                }
                keys.push((key, done));
            }
            (_, None) => match done.value {
                Value::Word(key) => *waiting = Some(key),
                _ => return wrong(done.line, "a key must be a word"),
            },
            (Value::Word(_), Some(_)) => {}
        }
    }
    wrong(1, "empty: not a calibration")
}

#[cfg(test)]
mod tests {
    use super::*;

    const OPENCV: &str = "%YAML:1.0\n---\ncalibration_time: \"Sun Nov 22\"\nimage_width: 640\nimage_height: 480\n\
        flags: 0\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 6.5746697e+02, 0.,\n       \
        3.195e+02, 0., 6.5746697e+02, 2.395e+02, 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 5\n   \
        cols: 1\n   dt: d\n   data: [ -4.18e-01, 5.06e-01, 0., 0., -5.7e-01 ]\n";

    #[test]
    fn files_of_others_are_read() {
        let lens = read(OPENCV).expect("OpenCV's");
        assert_eq!((lens.width, lens.height, lens.fx, lens.cy), (640, 480, 657.46697, 239.5));
        assert_eq!(lens.dist, [-0.418, 0.506, 0.0, 0.0, -0.57]);
        let ros = "image_width: 752\nimage_height: 480\ncamera_name: narrow\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
            data: [438.783, 0.0, 305.593, 0.0, 437.302, 243.738, 0, 0, 1]\ndistortion_model: plumb_bob\n\
            distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.36, 0.12, 0.001, 0.0003, 0]\n\
            projection_matrix:\n  rows: 3\n  cols: 4\n  data: [1,2,3,4,5,6,7,8,9,10,11,12]\n";
        assert_eq!(read(ros).expect("ROS's").dist.len(), 5);
        let message = "header:\n  seq: 1\nheight: 480\nwidth: 640\ndistortion_model: \"plumb_bob\"\nD:\n- -0.1\n- 0.2\n\
            - 0.0\n- 0.0\n- 0.0\nK: [500.0, 0.0, 320.0, 0.0, 501.0, 240.0, 0.0, 0.0, 1.0]\n---\n";
        let lens = read(message).expect("a message");
        assert_eq!((lens.fy, lens.dist[1]), (501.0, 0.2));
    }

    #[test]
    fn mistakes_are_answered_with_their_line() {
        let says = |from: &str, to: &str| {
            let text = OPENCV.replace(from, to);
            assert_ne!(text, OPENCV);
            read(&text).map(|_| ()).expect_err(to)
        };
        for (from, to, line, reason) in [
            ("640", "640.5", 4, "whole number"),
            ("image_height: 480", "image_hight: 480", 3, "no image_height"),
            ("6.5746697e+02, 0.,\n", "6.5746697e+02, x,\n", 11, "\"x\" is not a finite number"),
            ("   cols: 3", "   cols: 4", 11, "rows x cols say 12"),
            ("2.395e+02, 0., 0.", "2.395e+02, 0., 7.", 7, "not [fx 0 cx"),
            ("-4.18e-01, ", "", 17, "rows x cols say 5"),
            ("flags: 0", "flags: *no", 6, ""),
            ("flags: 0", "image_width: 3", 6, "twice"),
            ("flags: 0", "flags: [[[[[[[[[[1]]]]]]]]]]", 6, "too deep"),
            ("flags: 0", "distortion_model: equidistant", 6, "calibrate"),
            ("-4.18e-01", ".nan", 17, "finite"),
        ] {
            let error = says(from, to);
            assert!(error.reason.contains(reason), "{to}: {error:?}");
            assert_eq!(error.line, line, "{to}: {error:?}");
        }
        for text in ["", "---\n", "just words", "- 1\n- 2\n", "a: [1, 2", "\u{0}", "? [a]\n: b\n"] {
            assert!(!read(text).expect_err(text).reason.contains('\n'), "{text:?}");
        }
        let long = format!("a: [{}]", "1,".repeat(20_000));
        assert!(read(&long).expect_err("long").reason.contains("too long"));
    }
}
