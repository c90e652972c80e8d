//! The one SIMD level: which instruction set a body runs on is chosen here and nowhere else.
//!
//! Kernels are written once, generic over `fearless_simd::Simd`, and called through
//! `fearless_simd::dispatch!(level, ...)`. Every level gives the same bytes.

pub use fearless_simd::Level;

/// The level of this machine, or the one that `VERNISSAGE_SIMD` names (`scalar`, `sse2`, `sse4.2`, `avx2`,
/// `avx512`, `neon`) where the machine has it; an unknown or missing one falls back to the machine's best.
pub fn best() -> Level {
    static BEST: std::sync::OnceLock<Level> = std::sync::OnceLock::new();
    *BEST.get_or_init(|| {
        let wanted = std::env::var("VERNISSAGE_SIMD").unwrap_or_default();
        available().into_iter().find(|&level| name(level) == wanted).unwrap_or_else(Level::new)
    })
}

/// Every level this machine can run, scalar first, best last.
pub fn available() -> Vec<Level> {
    let mut levels = vec![Level::fallback()];
    let top = Level::new();
    #[cfg(target_arch = "x86_64")]
    {
        levels.extend(top.as_sse2().map(Level::Sse2));
        levels.extend(top.as_sse4_2().map(Level::Sse4_2));
        levels.extend(top.as_avx2().map(Level::Avx2));
        levels.extend(top.as_avx512().map(Level::Avx512));
    }
    #[cfg(target_arch = "aarch64")]
    levels.extend(top.as_neon().map(Level::Neon));
    levels
}

/// The level's name as in `VERNISSAGE_SIMD`.
pub fn name(level: Level) -> &'static str {
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Sse2(_) => "sse2",
        #[cfg(target_arch = "x86_64")]
        Level::Sse4_2(_) => "sse4.2",
        #[cfg(target_arch = "x86_64")]
        Level::Avx2(_) => "avx2",
        #[cfg(target_arch = "x86_64")]
        Level::Avx512(_) => "avx512",
        #[cfg(target_arch = "aarch64")]
        Level::Neon(_) => "neon",
        _ => "scalar",
    }
}
