#!/bin/busybox sh
# /init of the initramfs: loads the modules, mounts a temporary overlay over the host's root, and continues with boot.sh
# there.
b=/bin/busybox
$b mount -t proc proc /proc
$b mount -t sysfs sys /sys
$b mount -t devtmpfs dev /dev
while read -r module; do
  $b insmod "/modules/$module" || echo "rect-vm: cannot load module $module"
done </modules/order

options=trans=virtio,version=9p2000.L,msize=512000
# The host's root does not change in a way that affects the guest, so the guest may cache it.
$b mount -t 9p -o "$options,cache=loose,ro" root /lower
$b mount -t tmpfs tmpfs /overlay
$b mkdir /overlay/upper /overlay/work
$b mount -t overlay -o lowerdir=/lower,upperdir=/overlay/upper,workdir=/overlay/work overlay /new
for d in proc sys dev; do $b mount --move /$d /new/$d; done
$b mount -t tmpfs -o mode=755 tmpfs /new/run
$b mkdir /new/run/rect-vm
$b mount -t 9p -o "$options,cache=none" job /new/run/rect-vm
exec $b switch_root /new /bin/bash /run/rect-vm/boot.sh
