//! How figures are printed: the machine's facts and milliseconds.

use crate::pixels::simd;
use std::time::Duration;

/// Program version with its commit.
pub const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("VERNISSAGE_COMMIT"), ")");

/// The facts that a figure depends on: version, processor, SIMD level.
pub fn machine() -> String {
    format!("vernissage {VERSION}, {}, {}", processor(), simd::name(simd::best()))
}

/// The processor's name as the system gives it, or its architecture.
pub fn processor() -> String {
    let facts = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = facts.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    name.map_or(std::env::consts::ARCH, |(_, name)| name).to_string()
}

/// Milliseconds with three decimals.
pub fn ms(duration: Duration) -> String {
    format!("{:.3}", duration.as_secs_f64() * 1e3)
}
