//! The residuals as a picture: one SVG written by hand.

use crate::calibration::Calibration;
use std::fmt::Write;

const COLORS: [&str; 10] = [
    "#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2", "#7f7f7f",
    "#bcbd22",
];

/// The camera's picture with every point and, so many times too long that a typical one is seen, by how much it is off;
/// a color a view.
pub fn svg(solved: &Calibration) -> String {
    let size = solved.lens.size;
    let (width, height) = (size.width as f64, size.height as f64);
    let unit = width / 640.0;
    let times = nice(12.0 * unit / solved.rms_px.max(1e-6));
    let foot = 30.0 * unit;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"-.5 -.5 {width} {}\" font-family=\"sans-serif\" \
         font-size=\"{}\">\n<rect x=\"-.5\" y=\"-.5\" width=\"{width}\" height=\"{}\" fill=\"white\"/>\n\
         <rect x=\"-.5\" y=\"-.5\" width=\"{width}\" height=\"{height}\" fill=\"#f6f6f6\" stroke=\"#999\" \
         stroke-width=\"{unit}\"/>\n",
        height + foot,
        12.0 * unit,
        height + foot
    );
    for view in &solved.views {
        let color = COLORS[view.index % COLORS.len()];
        // writing to a String cannot fail
        _ = writeln!(out, "<g stroke=\"{color}\" fill=\"{color}\" stroke-width=\"{}\">", 0.8 * unit);
        for (px, miss) in &view.misses {
            let end = *px + *miss * times;
            _ = writeln!(
                out,
                "<path d=\"M{:.2} {:.2}L{:.2} {:.2}\"/><circle cx=\"{:.2}\" cy=\"{:.2}\" r=\"{}\"/>",
                px.x, px.y, end.x, end.y, px.x, px.y, unit
            );
        }
        out.push_str("</g>\n");
    }
    let center = solved.lens.center;
    _ = writeln!(
        out,
        "<path d=\"M{} {}h{}M{} {}v{}\" stroke=\"black\" stroke-width=\"{unit}\"/>",
        center.x - 8.0 * unit,
        center.y,
        16.0 * unit,
        center.x,
        center.y - 8.0 * unit,
        16.0 * unit
    );
    _ = writeln!(
        out,
        "<text x=\"{}\" y=\"{}\">misses drawn {times} times too long; RMS {:.3} px, {} views; the cross is the \
         principal point</text>\n</svg>",
        8.0 * unit,
        height + 0.65 * foot,
        solved.rms_px,
        solved.views.len()
    );
    out
}

/// The largest of 1, 2, 5, 10 .. below `value`.
fn nice(value: f64) -> f64 {
    let decade = libm::pow(10.0, libm::floor(libm::log10(value.max(1.0))));
    [5.0, 2.0].into_iter().map(|k| k * decade).find(|v| *v <= value).unwrap_or(decade)
}
