#!/bin/bash
# The command of `run --root`, as a service of the guest's systemd: with controllers, if there shall be some; reports its
# status and switches the machine off.
set -uo pipefail

here=/run/rect-vm controllers=0 shares=() command=() # set by:
# shellcheck source=/dev/null
. "$here/settings"
PATH=$here/guest:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
export PATH RECT_RELAY=$here/ble-relay

for i in "${!shares[@]}"; do
  mkdir -p "/run/share$i"
  mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000,cache=none "share$i" "/run/share$i"
done
for name in /sys/class/virtio-ports/*/name; do
  [[ $(<"$name") != rect.output ]] || name=${name%/name} port=/dev/${name##*/}
done
{
  status=0
  if ((controllers)); then
    room start "$controllers" || { echo "the emulated controllers do not start: $(room log | tail -n 3)"; status=125; }
  fi
  if ((status == 0)); then
    "${command[@]}"
    status=$?
  fi
} </dev/null >"${port:?}" 2>&1
dmesg | grep -E ' (BUG|Oops)\b|kernel BUG|general protection fault' >"$here/kernel_faults" || rm -f "$here/kernel_faults"
printf '%s\n' "$status" >"$here/status.new"
mv "$here/status.new" "$here/status"
sync
echo o >/proc/sysrq-trigger
