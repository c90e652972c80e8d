//! Time against error as a picture: one SVG scatter plot, written by hand.

use std::fmt::Write;

/// One mark of the plot.
pub struct Point {
    /// Marks of one series share a color.
    pub series: String,
    /// What this mark is.
    pub label: String,
    /// Milliseconds, > 0.
    pub ms: f64,
    /// Error, ≥ 0, in what the plot's axis says.
    pub error: f64,
}

const WIDTH: f64 = 980.0;
const HEIGHT: f64 = 620.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 240.0;
const TOP: f64 = 50.0;
const BOTTOM: f64 = 60.0;
/// Errors below this stand on the lowest line.
const LEAST_ERROR: f64 = 0.001;
const COLORS: [&str; 10] = [
    "#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2", "#7f7f7f",
    "#bcbd22",
];

/// The plot: time across, error up, both logarithmic. `axis` says what the error is.
pub fn svg(title: &str, axis: &str, points: &[Point]) -> String {
    let decades = |values: &mut dyn Iterator<Item = f64>| {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for log in values.map(libm::log10) {
            (low, high) = (low.min(log.floor()), high.max(log.ceil()));
        }
        if low < high { (low, high) } else { (-1.0, 1.0) }
    };
    let x_range = decades(&mut points.iter().map(|p| p.ms.max(1e-6)));
    let y_range = decades(&mut points.iter().map(|p| p.error.max(LEAST_ERROR)));
    let x = |ms: f64| {
        LEFT + (libm::log10(ms.max(1e-6)) - x_range.0) / (x_range.1 - x_range.0) * (WIDTH - LEFT - RIGHT)
    };
    let y = |error: f64| {
        let share = (libm::log10(error.max(LEAST_ERROR)) - y_range.0) / (y_range.1 - y_range.0);
        HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM)
    };
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" \
         font-size=\"12\">\n<rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"white\"/>\n\
         <text x=\"{LEFT}\" y=\"26\" font-size=\"15\">{}</text>\n",
        escaped(title)
    );
    let mut line = |text: String| {
        out.push_str(&text);
        out.push('\n');
    };
    for decade in x_range.0 as i32..=x_range.1 as i32 {
        let (value, bottom) = (libm::pow(10.0, f64::from(decade)), HEIGHT - BOTTOM);
        let at = x(value);
        line(format!("<line x1=\"{at:.1}\" y1=\"{TOP}\" x2=\"{at:.1}\" y2=\"{bottom}\" stroke=\"#ddd\"/>"));
        line(format!("<text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{value}</text>", bottom + 18.0));
    }
    for decade in y_range.0 as i32..=y_range.1 as i32 {
        let (value, right) = (libm::pow(10.0, f64::from(decade)), WIDTH - RIGHT);
        let at = y(value);
        let sign = if value <= LEAST_ERROR { "≤ " } else { "" };
        line(format!("<line x1=\"{LEFT}\" y1=\"{at:.1}\" x2=\"{right}\" y2=\"{at:.1}\" stroke=\"#ddd\"/>"));
        line(format!(
            "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{sign}{value}</text>",
            LEFT - 6.0,
            at + 4.0
        ));
    }
    let middle = (LEFT + WIDTH - RIGHT) / 2.0;
    line(format!(
        "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">ms a frame, minimum</text>",
        HEIGHT - 18.0
    ));
    let center = (TOP + HEIGHT - BOTTOM) / 2.0;
    line(format!(
        "<text transform=\"translate(18 {center}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        escaped(axis)
    ));
    let mut series: Vec<&str> = Vec::new();
    for point in points {
        let known = series.iter().position(|&name| name == point.series);
        let index = known.unwrap_or_else(|| {
            series.push(&point.series);
            series.len() - 1
        });
        let (color, px, py) = (COLORS[index % COLORS.len()], x(point.ms), y(point.error));
        let mut label = String::new();
        // writing to a String cannot fail
        let _ =
            write!(label, "{} {}: {:.3} ms, error {:.4}", point.series, point.label, point.ms, point.error);
        line(format!(
            "<circle cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"4\" fill=\"{color}\" fill-opacity=\".8\"><title>{}</title></circle>",
            escaped(&label)
        ));
        line(format!(
            "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"9\" fill=\"{color}\">{}</text>",
            px + 6.0,
            py + 3.0,
            escaped(&point.label)
        ));
    }
    for (index, name) in series.iter().enumerate() {
        let (left, at, color) =
            (WIDTH - RIGHT + 20.0, TOP + 20.0 * index as f64, COLORS[index % COLORS.len()]);
        line(format!("<circle cx=\"{left}\" cy=\"{at}\" r=\"5\" fill=\"{color}\"/>"));
        line(format!("<text x=\"{}\" y=\"{}\">{}</text>", left + 12.0, at + 4.0, escaped(name)));
    }
    out.push_str("</svg>\n");
    out
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_is_inside_and_named() {
        let point = |series: &str, ms, error| Point { series: series.into(), label: "a<b".into(), ms, error };
        let points = [point("cartoon", 2.5, 0.0), point("cartoon", 30.0, 4.0), point("plain", 0.02, 0.5)];
        let plot = svg("time & error", "px > 0", &points);
        assert!(plot.contains("time &amp; error") && plot.contains("px &gt; 0"));
        assert!(plot.contains("a&lt;b") && plot.ends_with("</svg>\n"));
        assert_eq!(plot.matches("r=\"4\"").count(), 3);
        for circle in plot.lines().filter(|line| line.contains("r=\"4\"")) {
            let number = |name: &str| -> f64 {
                let rest = circle.split(name).nth(1).expect("attribute");
                rest.split('"').nth(1).expect("value").parse().expect("number")
            };
            assert!((LEFT..=WIDTH - RIGHT).contains(&number("cx=")), "{circle}");
            assert!((TOP..=HEIGHT - BOTTOM).contains(&number("cy=")), "{circle}");
        }
        assert!(svg("nothing", "", &[]).contains("nothing"));
    }
}
