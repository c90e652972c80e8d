#!/usr/bin/env bash
# Builds the virtual ARM board: the static binary, Debian's arm64 kernel, and an initramfs that holds both.
#
# usage: build.sh [DIR]          DIR: where the board goes, default target/virtual-board
# needs: what install.sh installs, and cargo. Downloads (kernel, busybox) and the cross build (target-arm/) are
# kept, so a second run takes seconds. Leaves in DIR: vmlinuz, initrd.gz, vernissage.
# RUSTC_ARM: a compiler with the aarch64-unknown-linux-gnu standard library, default /usr/bin/rustc (rustc-web).
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
dir=${1:-$root/target/virtual-board}
mkdir -p "$dir/deb" "$dir/init"/{bin,mods,proc,sys,dev,tmp,host}
dir=$(cd "$dir" && pwd)

# the binary: static, for the board's own core; a target directory of its own keeps the two compilers apart
target=aarch64-unknown-linux-gnu
(cd "$root" && RUSTC=${RUSTC_ARM:-/usr/bin/rustc} \
  RUSTFLAGS="-C target-feature=+crt-static -C target-cpu=cortex-a72" \
  CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc \
  CARGO_TARGET_DIR="$root/target-arm" \
  cargo build --release --quiet --no-default-features --target "$target" --bin vernissage)
cp "$root/target-arm/$target/release/vernissage" "$dir/vernissage"
for program in feed ctl hold; do
  aarch64-linux-gnu-gcc -std=gnu11 -O2 -Wall -Wextra -Werror -static -o "$dir/$program" "$here/$program.c"
done

# Debian's kernel and busybox, fetched once; apt runs here as whoever we are, into our own folder
if ! [ -d "$dir/kernel/lib/modules" ] || ! [ -x "$dir/busybox/bin/busybox" ]; then
  kernel=$(apt-cache depends linux-image-arm64:arm64 | sed -n 's/.*Depends: \(linux-image-[0-9][^:]*\).*/\1/p' | head -1)
  [ -n "$kernel" ] || { echo "build.sh: apt knows no linux-image-arm64:arm64; run install.sh first" >&2; exit 2; }
  (cd "$dir/deb" && apt-get -o APT::Sandbox::User="$(id -un)" download -qq "$kernel:arm64" busybox-static:arm64)
  dpkg -x "$dir"/deb/"$kernel"_*.deb "$dir/kernel"
  dpkg -x "$dir"/deb/busybox-static_*.deb "$dir/busybox"
fi
release=$(ls "$dir/kernel/lib/modules")
/sbin/depmod -b "$dir/kernel" "$release"

# the initramfs: busybox, the modules in the order they want to be loaded, our programs, /init; the modules of a USB
# port with a serial adapter, and of a disk, lie aside for the tests that want one
dependencies() {
  for module in "$@"; do
    /sbin/modprobe -d "$dir/kernel" -S "$release" --show-depends "$module" | awk '/^insmod/{print $2}'
  done | awk '!seen[$0]++'
}
dependencies virtio_gpu virtio_pci virtio_console 9p 9pnet_virtio vivid > "$dir/modules"
dependencies xhci_pci ftdi_sio > "$dir/modules.usb"
dependencies virtio_blk ext4 > "$dir/modules.disk"
rm -f "$dir"/init/mods/*
sort -u "$dir/modules" "$dir/modules.usb" "$dir/modules.disk" | xargs cp -t "$dir/init/mods/"
awk -F/ '{print $NF}' "$dir/modules" | grep -v '^vivid.ko' > "$dir/init/mods/order"
for kind in usb disk; do awk -F/ '{print $NF}' "$dir/modules.$kind" > "$dir/init/mods/$kind"; done
cp "$dir/busybox/bin/busybox" "$dir/init/bin/"
cp "$dir/vernissage" "$dir/feed" "$dir/ctl" "$dir/hold" "$dir/init/bin/"
cp "$here/init.sh" "$dir/init/init"
chmod +x "$dir/init/init"
(cd "$dir/init" && find . | cpio -o -H newc 2>/dev/null | gzip -1) > "$dir/initrd.gz"
cp "$dir/kernel/boot/vmlinuz-$release" "$dir/vmlinuz"
