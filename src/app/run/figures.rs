//! The figures of a run in a line, or as JSON.

use super::tally::Tally;
use crate::app::report::ms;
use crate::pipeline::Stage;

/// For people.
pub fn line(tally: &Tally) -> String {
    let [p50, p99] = tally.latency().percentiles([0.5, 0.99]).map(ms);
    let shown = tally.shown.get();
    let mut line = format!(
        "{shown} shown ({:.1}/s), {} tracked, {} missing in the sequence ({} replaced by newer), \
         {} out of order; capture to shown p50 {p50} ms, p99 {p99} ms;",
        shown as f64 / tally.started.elapsed().as_secs_f64().max(1e-9),
        tally.tracked.get(),
        tally.missing.get(),
        tally.replaced.get(),
        tally.backwards.get(),
    );
    for stage in Stage::ALL {
        line += &format!(" {} {}", stage.name(), ms(tally.stage(stage).percentiles([0.5])[0]));
    }
    line + " ms"
}

/// For programs.
pub fn json(tally: &Tally) -> serde_json::Value {
    let in_ms = |d: std::time::Duration| d.as_secs_f64() * 1e3;
    let stages: serde_json::Map<_, _> = Stage::ALL
        .iter()
        .map(|&s| (s.name().to_string(), in_ms(tally.stage(s).percentiles([0.5])[0]).into()))
        .collect();
    let [p50, p99] = tally.latency().percentiles([0.5, 0.99]).map(in_ms);
    serde_json::json!({
        "shown": tally.shown.get(), "seconds": tally.started.elapsed().as_secs_f64(),
        "tracked": tally.tracked.get(), "slates": tally.slates.get(), "missing": tally.missing.get(),
        "replaced": tally.replaced.get(), "out_of_order": tally.backwards.get(),
        "latency_ms": { "p50": p50, "p99": p99 },
        "stages_ms": stages,
    })
}
