#!/bin/busybox sh
# First process of the virtual board: loads the drivers, runs /host/run.sh (the host's shared folder), powers off.
/bin/busybox --install -s /bin
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
mount -t tmpfs tmp /tmp
for module in $(cat /mods/order); do insmod "/mods/$module"; done
mount -t 9p -o trans=virtio,version=9p2000.L,msize=524288 host /host
# what kind of camera there is: by default one capture node (video0) and one output node (video1), both HDMI: what is
# written to video1 is seen by video0
camera="node_types=0x101 num_inputs=1 input_types=0x3 num_outputs=1 output_types=1"
[ ! -e /host/camera ] || camera=$(cat /host/camera)
insmod /mods/vivid.ko vid_cap_nr=0 vid_out_nr=1 $camera
sh /host/run.sh
sync
poweroff -f
