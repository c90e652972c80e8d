#!/usr/bin/env bash
# Installs the Debian packages that build.sh, debian.sh, boot.sh and the tests need (bookworm or newer, as root).
# rustc-web is Debian's newer Rust compiler; the arm64 standard library beside it makes it a cross compiler.
set -euo pipefail
dpkg --print-foreign-architectures | grep -qx arm64 || dpkg --add-architecture arm64
apt-get update -qq
DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends \
  qemu-system-arm cpio gzip kmod e2fsprogs python3 \
  rustc-web libstd-rust-web-dev:arm64 gcc-aarch64-linux-gnu libc6-dev-arm64-cross
