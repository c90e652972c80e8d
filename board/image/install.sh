#!/usr/bin/env bash
# Installs the Debian packages that build.sh and try.py here need (bookworm or newer, as root), and lets this machine
# run ARM programs: the packages of the image are configured by their own scripts.
set -euo pipefail
apt-get update -qq
DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends \
  mmdebstrap arch-test qemu-user-static squashfs-tools mtools dosfstools e2fsprogs fdisk \
  python3 qemu-system-arm qemu-efi-aarch64
if ! arch-test arm64 > /dev/null; then
  # a container or a virtual machine without a service manager: nobody did it when the package was installed
  mountpoint -q /proc/sys/fs/binfmt_misc || mount -t binfmt_misc binfmt_misc /proc/sys/fs/binfmt_misc
  /lib/systemd/systemd-binfmt qemu-aarch64.conf
  arch-test arm64
fi
