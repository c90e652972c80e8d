#!/usr/bin/env bash
# Boots a card image on an emulated board with UEFI firmware: two Cortex-A72 and a 640x480 screen, no camera.
#
# usage: boot.sh DIR IMAGE [qemu options]     IMAGE: a file in DIR; what is written to the card is kept in it
# The firmware's console is stdout. DIR/monitor.sock takes monitor commands, such as `screendump FILE.ppm`.
set -euo pipefail
dir=$1
image=$2
shift 2
cd "$dir" # socket paths have a length limit
rm -f monitor.sock
exec qemu-system-aarch64 -M virt -cpu cortex-a72 -accel tcg -smp 2 -m 1024 -display none -nic none \
  -bios /usr/share/qemu-efi-aarch64/QEMU_EFI.fd -drive "file=$image,if=virtio,format=raw" \
  -device virtio-gpu-pci,xres=640,yres=480 -monitor unix:monitor.sock,server,nowait -serial stdio "$@"
