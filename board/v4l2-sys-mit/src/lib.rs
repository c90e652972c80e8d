//! Raw Video4Linux2 types and constants of `linux/videodev2.h`, for 64-bit Linux (x86-64 and aarch64
//! share one layout; the asserts in `bindings.rs` fail the build where that is not so).
//!
//! Stands in for the published `v4l2-sys-mit`, whose build script runs bindgen and so needs libclang.
//! Made once with bindgen 0.72 from Debian 12's kernel headers:
//! `--allowlist-item '[vV]4[lL]2_.*|VIDIOC_.*' --allowlist-type 'timeval|timespec|time_t' --no-doc-comments`.
#![allow(clippy::all, missing_docs, non_camel_case_types, non_snake_case, non_upper_case_globals)]

include!("bindings.rs");
