//! The one SIMD level: which instruction set a body runs on is chosen here and nowhere else.
//!
//! Kernels are written once, generic over `fearless_simd::Simd`, and called through `dispatch`. Every level
//! gives the same bytes. Three bodies are built on x86-64 (scalar, SSE 4.2, AVX2), two on ARM (scalar, NEON):
//! more levels would cost compile time and size, and nothing here is written for wider vectors. A release for ARM has
//! NEON alone: every ARM of 64 bits has it, and nothing but tests would run the scalar twins.

pub use fearless_simd::Level;

/// `dispatch!(level, simd => expression)`: the expression with `simd` bound to the best token that `level` has,
/// compiled once for each.
macro_rules! dispatch {
    ($level:expr, $simd:pat => $op:expr) => {{
        let level: $crate::pixels::simd::Level = $level;
        #[cfg(target_arch = "x86_64")]
        {
            if let Some(token) = level.as_avx2() {
                $crate::pixels::simd::run!(token, $simd => $op)
            } else if let Some(token) = level.as_sse4_2() {
                $crate::pixels::simd::run!(token, $simd => $op)
            } else {
                $crate::pixels::simd::run!($crate::pixels::simd::scalar(), $simd => $op)
            }
        }
        #[cfg(all(target_arch = "aarch64", not(debug_assertions)))]
        {
            $crate::pixels::simd::run!($crate::pixels::simd::neon(level), $simd => $op)
        }
        #[cfg(all(target_arch = "aarch64", debug_assertions))]
        {
            if let Some(token) = level.as_neon() {
                $crate::pixels::simd::run!(token, $simd => $op)
            } else {
                $crate::pixels::simd::run!($crate::pixels::simd::scalar(), $simd => $op)
            }
        }
        #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
        {
            let _ = level;
            $crate::pixels::simd::run!($crate::pixels::simd::scalar(), $simd => $op)
        }
    }};
}

/// One arm of [`dispatch`]: the body under the token's target features.
macro_rules! run {
    ($token:expr, $simd:pat => $op:expr) => {{
        let token = $token;
        let $simd = $crate::pixels::simd::opaque(token);
        fearless_simd::Simd::vectorize(
            token,
            #[inline(always)]
            || $op,
        )
    }};
}

pub(crate) use {dispatch, run};

/// The token as some instruction set, so that a body cannot name which.
#[inline(always)]
pub(crate) fn opaque<S: fearless_simd::Simd>(token: S) -> impl fearless_simd::Simd {
    token
}

/// The scalar twin's token.
#[cfg(any(not(target_arch = "aarch64"), debug_assertions, test))]
#[inline(always)]
pub(crate) fn scalar() -> fearless_simd::Fallback {
    match Level::fallback() {
        Level::Fallback(token) => token,
        _ => unreachable!("the feature force_support_fallback is on"),
    }
}

/// NEON's token, whatever the level: the same bytes.
#[cfg(all(target_arch = "aarch64", not(debug_assertions)))]
#[inline(always)]
pub(crate) fn neon(level: Level) -> fearless_simd::Neon {
    match (level, Level::new()) {
        (Level::Neon(token), _) | (_, Level::Neon(token)) => token,
        _ => unreachable!("every ARM of 64 bits has NEON"),
    }
}

/// The level of this machine, or the one that `VERNISSAGE_SIMD` names (`scalar`, `sse4.2`, `avx2`, `neon`) where the machine has it; an unknown or missing one falls back to the machine's best.
pub fn best() -> Level {
    static BEST: std::sync::OnceLock<Level> = std::sync::OnceLock::new();
    *BEST.get_or_init(|| {
        let wanted = std::env::var("VERNISSAGE_SIMD").unwrap_or_default();
        available().into_iter().find(|&level| name(level) == wanted).unwrap_or_else(Level::new)
    })
}

/// Every level this machine can run, scalar first where it is built, best last.
pub fn available() -> Vec<Level> {
    let scalar = cfg!(any(not(target_arch = "aarch64"), debug_assertions)).then(Level::fallback);
    let mut levels: Vec<Level> = scalar.into_iter().collect();
    let top = Level::new();
    #[cfg(target_arch = "x86_64")]
    {
        levels.extend(top.as_sse4_2().map(Level::Sse4_2));
        levels.extend(top.as_avx2().map(Level::Avx2));
    }
    #[cfg(target_arch = "aarch64")]
    levels.extend(top.as_neon().map(Level::Neon));
    levels
}

/// The level's name as in `VERNISSAGE_SIMD`.
pub fn name(level: Level) -> &'static str {
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Sse4_2(_) => "sse4.2",
        #[cfg(target_arch = "x86_64")]
        Level::Avx2(_) | Level::Avx512(_) => "avx2",
        #[cfg(target_arch = "aarch64")]
        Level::Neon(_) => "neon",
        _ => "scalar",
    }
}
