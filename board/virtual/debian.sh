#!/usr/bin/env bash
# Builds a disk with Debian's own systemd for the virtual board, and an initramfs that starts from it.
#
# usage: debian.sh [DIR]         DIR: where build.sh made the board, default target/virtual-board
# needs: what install.sh installs, as root. Packages are fetched once; a second run takes seconds. Leaves in DIR:
# debian.ext4 (systemd, udev, kmod and what they load, nothing configured), debian.gz.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
dir=$(cd "${1:-$root/target/virtual-board}" && pwd)
release=$(ls "$dir/kernel/lib/modules")

# systemd, udev, kmod, what installs files, and their libraries; maintainer scripts are not needed, nothing runs them
packages=(systemd udev kmod mount coreutils libattr1 libsystemd-shared libsystemd0 libudev1 libkmod2 libacl1
  libapparmor1 libargon2-1 libaudit1 libblkid1 libcap2 libcap-ng0 libcrypt1 libcryptsetup12 libdevmapper1.02.1
  libfdisk1 libgcrypt20 libgpg-error0 libip4tc2 libjson-c5 liblz4-1 liblzma5 libmount1 libp11-kit0
  libffi8 libpam0g libpcre2-8-0 libseccomp2 libselinux1 libsmartcols1 libssl3 libuuid1 libzstd1 zlib1g libc6 libgcc-s1)
if ! [ -f "$dir/debian/fetched" ]; then
  rm -rf "$dir/debian"
  mkdir -p "$dir/debian"
  (cd "$dir/debian" && apt-get -o APT::Sandbox::User="$(id -un)" download -qq "${packages[@]/%/:arm64}")
  touch "$dir/debian/fetched"
fi

if ! [ -f "$dir/debian.ext4" ] || [ "$here/debian.sh" -nt "$dir/debian.ext4" ]; then
  tree=$(mktemp -d)
  trap 'rm -r "$tree"' EXIT
  chmod 755 "$tree"
  mkdir -p "$tree"/usr/{bin,sbin,lib,share} "$tree"/{dev,proc,sys,run,tmp,var,etc,root,host} "$tree/usr/lib/board"
  for name in bin sbin lib; do ln -s "usr/$name" "$tree/$name"; done
  for package in "$dir"/debian/*.deb; do
    # tar, for dpkg -x would put folders in the place of the three links
    dpkg-deb --fsys-tarfile "$package" | tar -x -C "$tree" --keep-directory-symlink \
      --exclude='./usr/share/doc' --exclude='./usr/share/man' --exclude='./usr/share/locale' \
      --exclude='./usr/lib/*/gconv'
  done
  cp "$dir/busybox/bin/busybox" "$tree/usr/bin/"
  # what a Debian has before its first boot: root, and the groups of devices
  echo 'root:x:0:0:root:/root:/bin/sh' > "$tree/etc/passwd"
  printf '%s\n' root:x:0: tty:x:5: disk:x:6: kmem:x:15: dialout:x:20: cdrom:x:24: tape:x:26: audio:x:29: \
    video:x:44: input:x:104: sgx:x:105: kvm:x:106: render:x:107: \
    systemd-journal:x:101: nogroup:x:65534: > "$tree/etc/group"
  echo 0123456789abcdef0123456789abcdef > "$tree/etc/machine-id"
  # the console is the test's
  mkdir -p "$tree/etc/systemd/system"
  ln -s /dev/null "$tree/etc/systemd/system/serial-getty@ttyAMA0.service"
  ln -s /dev/null "$tree/etc/systemd/system/getty@tty1.service"
  # the display's driver lies aside: it is loaded when the test plugs the display in
  for module in videodev drm_shmem_helper virtio_dma_buf cdc_acm ftdi_sio virtio_gpu; do
    /sbin/modprobe -d "$dir/kernel" -S "$release" --show-depends "$module" | awk '/^insmod/{print $2}'
  done | sort -u | while read -r module; do
    case $module in
      */virtio-gpu.ko) cp "$module" "$tree/usr/lib/board/" ;;
      *) install -D -m644 "$module" "$tree/lib/modules/$release/${module##*"/$release/"}" ;;
    esac
  done
  cp "$dir/kernel/lib/modules/$release"/modules.{order,builtin,builtin.modinfo} "$tree/lib/modules/$release/"
  /sbin/depmod -b "$tree" "$release"
  rm -f "$dir/debian.ext4"
  /sbin/mke2fs -q -t ext4 -O ^has_journal -E root_owner=0:0 -L debian -d "$tree" "$dir/debian.new" 192M > /dev/null
  mv "$dir/debian.new" "$dir/debian.ext4"
fi

# the initramfs: busybox, the drivers of disk, camera and shared folder, the camera's feeder
early=$dir/debian-init
rm -rf "$early"
mkdir -p "$early"/{bin,mods,proc,sys,dev,disk}
for module in virtio_pci virtio_blk ext4 9p 9pnet_virtio xhci_pci vivid; do
  /sbin/modprobe -d "$dir/kernel" -S "$release" --show-depends "$module" | awk '/^insmod/{print $2}'
done | awk '!seen[$0]++' > "$early/mods/all"
xargs -a "$early/mods/all" cp -t "$early/mods/"
awk -F/ '{print $NF}' "$early/mods/all" | grep -v '^vivid.ko' > "$early/mods/order"
cp "$dir/busybox/bin/busybox" "$dir/feed" "$early/bin/"
install -m755 "$here/debian_init.sh" "$early/init"
(cd "$early" && find . | cpio -o -H newc 2> /dev/null | gzip -1) > "$dir/debian.gz"
