//! One image kernel a file: a fast body, generic over the SIMD level, and its plain f64 reference.

pub mod yuv;

#[cfg(test)]
pub(crate) mod sweep;
