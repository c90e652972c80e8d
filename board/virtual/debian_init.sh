#!/bin/busybox sh
# First process of the virtual board with a Debian: loads the drivers, starts the camera's signal, installs what
# /host/install.sh installs, and hands over to systemd.
/bin/busybox --install -s /bin
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
for module in $(cat /mods/order); do insmod "/mods/$module"; done
# one capture node (video0) and one output node (video1), both HDMI: what is written to video1 is seen by video0
insmod /mods/vivid.ko vid_cap_nr=0 vid_out_nr=1 node_types=0x101 num_inputs=1 input_types=0x3 num_outputs=1 output_types=1
mount -t ext4 -o relatime /dev/vda /disk
mount -t 9p -o trans=virtio,version=9p2000.L,msize=524288 host /disk/host
[ "$(stat -c %u /disk/usr)" = 0 ] || chown -R 0:0 /disk/usr /disk/etc /disk/var
# frames must flow before anything looks at the camera; 60 % of them are lost: 24 a second are enough here
feed /disk/host/service.yuyv 640 480 1 60 > /feed.log 2>&1 &
for i in $(seq 300); do grep -q feeding /feed.log && break; sleep .1; done
cat /feed.log
echo BOARD: fed $(cat /proc/uptime)
mount --move /proc /disk/proc
mount --move /sys /disk/sys
mount --move /dev /disk/dev
chroot /disk /bin/busybox --install -s /usr/bin
chroot /disk /bin/sh /host/install.sh || echo "BOARD: install failed"
echo BOARD: installed $(cat /proc/uptime)
exec switch_root /disk /lib/systemd/systemd
