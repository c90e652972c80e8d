//! A page as SVG, in millimetres.

use super::page::{Hold, Mark, Page};
use std::fmt::Write;

/// The page; a shape of several rectangles is one path.
pub fn svg(page: &Page) -> String {
    let [width, height] = page.size.map(number);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" \
         viewBox=\"0 0 {width} {height}\" font-family=\"Helvetica, Arial, sans-serif\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n"
    );
    for mark in &page.marks {
        // writing to a String cannot fail
        _ = match mark {
            Mark::Ink(rects) => {
                let shape: String = rects.iter().fold(String::new(), |mut shape, rect| {
                    let [x, y, w, h] = rect.map(number);
                    _ = write!(shape, "M{x} {y}h{w}v{h}h-{w}z");
                    shape
                });
                writeln!(out, "<path d=\"{shape}\"/>")
            }
            Mark::Text { at, size, hold, text } => {
                let ([x, y], size) = (at.map(number), number(*size));
                let anchor = if *hold == Hold::Middle { " text-anchor=\"middle\"" } else { "" };
                writeln!(out, "<text x=\"{x}\" y=\"{y}\" font-size=\"{size}\"{anchor}>{text}</text>")
            }
        };
    }
    out + "</svg>\n"
}

/// Without the dust of sums, to a nanometre.
fn number(mm: f64) -> f64 {
    (mm * 1e6).round() / 1e6
}
