#!/usr/bin/env bash
# Boots the board that build.sh made: an emulated Cortex-A72 with a 640x480 screen and a kernel camera.
#
# usage: boot.sh DIR [qemu options]     DIR/host/run.sh is what the board does; DIR/host is its /host
# The console is stdin and stdout. DIR/monitor.sock takes monitor commands, such as `screendump FILE.ppm`.
# Useful options: -smp 1 -icount shift=0,sleep=off   one instruction is one nanosecond of the board's clock,
# the same in every run.
# Software emulation only: KVM is no help for another architecture, and hangs on some virtual machines.
set -euo pipefail
dir=$1
shift
mkdir -p "$dir/host"
cd "$dir" # socket paths have a length limit
rm -f monitor.sock
exec qemu-system-aarch64 -M virt -cpu cortex-a72 -accel tcg -smp 2 -m 1024 -display none -nic none -no-reboot \
  -kernel vmlinuz -initrd initrd.gz -append "console=ttyAMA0 panic=-1 quiet" \
  -device virtio-gpu-pci,xres=640,yres=480 \
  -virtfs local,path=host,mount_tag=host,security_model=none \
  -monitor unix:monitor.sock,server,nowait -serial stdio "$@"
