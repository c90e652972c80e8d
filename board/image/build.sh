#!/usr/bin/env bash
# Builds a card image for an ARM board: Debian on a read-only root with the visor as its only service.
#
# usage: build.sh [--visor FILE] [--program FILE] [--dir DIR]
#   --visor    settings to begin with, default board/rpi4.toml
#   --program  the visor for ARM, default target-arm/aarch64-unknown-linux-gnu/release/vernissage
#   --dir      where the image goes, default target/image
# needs: what install.sh here installs, as root. Debian is fetched and configured once (some minutes, for its scripts
# are ARM programs); a second run takes one. Leaves in DIR: visor.img, to be written to a card as it is.
#
# Three partitions: VISOR (FAT, what the firmware starts, visor.toml and whatever it names: any computer can open it,
# the board never writes to it), root (squashfs: it cannot be written to), state (ext4, the settings that were good
# last). What else wants to write gets memory. Boots on a Raspberry Pi 3 or 4 and on boards with UEFI firmware.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
visor=$root/board/rpi4.toml
program=$root/target-arm/aarch64-unknown-linux-gnu/release/vernissage
dir=$root/target/image
fail() { echo "build.sh: $*" >&2; exit 2; }
while [ $# -gt 0 ]; do
  [ $# -gt 1 ] || fail "$1 wants a value"
  case $1 in
    --visor) visor=$2 ;;
    --program) program=$2 ;;
    --dir) dir=$2 ;;
    *) fail "unknown option $1; there are --visor, --program and --dir" ;;
  esac
  shift 2
done
[ -f "$visor" ] || fail "$visor: no such settings file"
[ -x "$program" ] || fail "$program: no such program; board/README.md says how to build it"
[ "$(id -u)" = 0 ] || fail "configuring Debian's packages needs root"
mkdir -p "$dir"
dir=$(cd "$dir" && pwd)

# Debian: the service manager, the kernel, what starts a board; the drivers an initramfs needs to reach a card or a stick
packages=systemd-sysv,udev,kmod,e2fsprogs,initramfs-tools,zstd,linux-image-arm64,raspi-firmware,systemd-boot-efi
drivers="squashfs ext4 vfat nls_cp437 nls_ascii virtio_pci virtio_blk mmc_block sdhci_iproc bcm2835 uas usb_storage
  sd_mod xhci_pci pcie_brcmstb nvme"
release=$(. /etc/os-release && echo "${VERSION_CODENAME:-}")
recipe="$release $packages $drivers"
if ! [ -f "$dir/debian.tar" ] || [ "$(cat "$dir/debian.recipe")" != "$recipe" ]; then
  # from where this machine has its own packages; the Pi's firmware is not free
  sources=$(apt-get indextargets --format 'deb $(REPO_URI) $(RELEASE) main non-free-firmware' \
    'Created-By: Packages' 'Origin: Debian' | sort -u)
  [ -n "$sources" ] || fail "this machine's packages are not Debian's; build the image on a Debian"
  # every driver there is would be copied file by file, in emulation
  cat > "$dir/lean.sh" << end
mkdir -p "\$1/etc/initramfs-tools/conf.d" "\$1/usr/share/initramfs-tools/modules.d"
echo MODULES=list > "\$1/etc/initramfs-tools/conf.d/visor"
printf '%s\n' $(echo $drivers) > "\$1/usr/share/initramfs-tools/modules.d/visor"
end
  mmdebstrap --mode=root --format=tar --architectures=arm64 --variant=essential \
    --include="$packages" \
    --aptopt='Acquire::Languages "none"' --essential-hook="sh '$dir/lean.sh' \"\$1\"" \
    --dpkgopt='path-exclude=/usr/share/man/*' --dpkgopt='path-exclude=/usr/share/locale/*' \
    --dpkgopt='path-exclude=/usr/share/doc/*' "$release" "$dir/debian.new" - <<< "$sources"
  mv "$dir/debian.new" "$dir/debian.tar"
  echo "$recipe" > "$dir/debian.recipe"
fi

work=$(mktemp -d)
clean() {
  ! mountpoint -q "$work/tree/proc" || umount "$work/tree/proc"
  rm -r --one-file-system "$work"
}
trap clean EXIT
tree=$work/tree
card=$work/card
mkdir "$tree" "$card"
tar -xf "$dir/debian.tar" -C "$tree" --exclude='./dev/*'

# the visor, by the lines that anybody would type
mkdir -p "$tree/tmp/vernissage/target/release" "$tree/tmp/vernissage/board"
cp -r "$root/systemd" "$tree/tmp/vernissage/"
cp "$visor" "$tree/tmp/vernissage/board/rpi4.toml"
cp "$program" "$tree/tmp/vernissage/target/release/vernissage"
awk '/^```/{fence++; next} fence == 1' "$root/systemd/README.md" > "$tree/tmp/vernissage/install.sh"
mount --bind /proc "$tree/proc"
chroot "$tree" sh -e -c 'cd /tmp/vernissage && . ./install.sh'
umount "$tree/proc"
rm -r "$tree/tmp/vernissage"
owner=$(awk -F: '$1 == "vernissage" {print $3 ":" $4}' "$tree/etc/passwd")

# the card's first partition is /etc/vernissage; by a link, for a service waits for what is mounted there itself
mv "$tree/etc/vernissage/visor.toml" "$card/"
rmdir "$tree/etc/vernissage"
ln -s /card "$tree/etc/vernissage"
cp "$here/README.txt" "$card/"
cp "$root/board/FAULTS.md" "$card/FAULTS.txt"
cp -r "$tree"/boot/firmware/. "$card/"
mkdir -p "$card/EFI/BOOT" "$card/loader/entries"
cp "$tree/usr/lib/systemd/boot/efi/systemd-bootaa64.efi" "$card/EFI/BOOT/BOOTAA64.EFI"
chroot "$tree" dpkg-query -W > "$dir/packages.txt"
rm -r "$tree/boot" "$tree/etc/apt" "$tree/usr/lib/raspi-firmware" "$tree"/var/*
mkdir "$tree/card" "$tree/state"
# nothing here ages, and nobody looks at a console
for unit in fstrim.timer e2scrub_all.timer dpkg-db-backup.timer getty@tty1.service; do
  ln -sf /dev/null "$tree/etc/systemd/system/$unit"
done

# what differs from image to image has another number, and its parts are found by it
id=$( (sha256sum "$program" "$visor"; echo "$recipe") | sha256sum | cut -c1-8)
part="nofail,x-systemd.before=vernissage.service,x-systemd.device-timeout=30s"
cat > "$tree/etc/fstab" << end
PARTUUID=$id-02 /      squashfs ro                               0 0
PARTUUID=$id-01 /card  vfat     ro,umask=022,$part               0 0
PARTUUID=$id-03 /state ext4     noatime,nosuid,nodev,noexec,$part 0 2
tmpfs           /var   tmpfs    mode=755,size=32M                0 0
tmpfs           /tmp   tmpfs    mode=1777,size=32M               0 0
end
echo visor > "$tree/etc/hostname"
: > "$tree/etc/machine-id" # another one at every start, in memory
mkdir -p "$tree"/etc/systemd/{journald.conf.d,system.conf.d,system/vernissage.service.d}
printf '[Journal]\nStorage=volatile\nRuntimeMaxUse=16M\n' > "$tree/etc/systemd/journald.conf.d/visor.conf"
# a board whose kernel hangs is started again by its own watchdog
printf '[Manager]\nRuntimeWatchdogSec=15s\n' > "$tree/etc/systemd/system.conf.d/visor.conf"
# where the state cannot be mounted the visor runs without
printf '[Service]\nBindPaths=/state:/var/lib/vernissage\n' > "$tree/etc/systemd/system/vernissage.service.d/state.conf"

kernel=$(cd "$card" && echo vmlinuz-*)
initrd=$(cd "$card" && echo initrd.img-*)
line="root=PARTUUID=$id-02 rootfstype=squashfs ro rootwait quiet loglevel=3 panic=10 fsck.repair=yes cma=64M"
line="$line vt.global_cursor_default=0"
echo "$line" > "$card/cmdline.txt"
printf 'title vernissage\nlinux /%s\ninitrd /%s\noptions %s\n' "$kernel" "$initrd" "$line" > "$card/loader/entries/visor.conf"
printf 'timeout 0\neditor no\n' > "$card/loader/loader.conf"

mksquashfs "$tree" "$work/root" -noappend -comp zstd -quiet -no-progress
mkfs.vfat -F 32 -n VISOR -C "$work/visor" $((128 << 10)) > /dev/null
mcopy -s -i "$work/visor" "$card"/* ::
mke2fs -q -t ext4 -L state -E root_owner="$owner" "$work/state" 64M > /dev/null

mebibytes() { echo $((($(stat -c %s "$1") + (1 << 20) - 1) >> 20)); }
rm -f "$dir/visor.new"
at=1
table="label: dos"$'\n'"label-id: 0x$id"
for part in visor:c root:83 state:83; do
  file=$work/${part%:*}
  size=$(mebibytes "$file")
  dd if="$file" of="$dir/visor.new" bs=1M seek=$at conv=notrunc,sparse status=none
  table+=$'\n'"start=${at}MiB, size=${size}MiB, type=${part#*:}"
  at=$((at + size))
done
truncate -s "${at}M" "$dir/visor.new"
sfdisk -q "$dir/visor.new" <<< "$table"
mv "$dir/visor.new" "$dir/visor.img"
echo "$dir/visor.img: $at MiB"
