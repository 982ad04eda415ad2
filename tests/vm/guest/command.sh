#!/bin/bash
# Runs the command of `run --root` as a service of the guest's systemd, with controllers if requested. Reports the exit
# status and powers the machine off.
set -uo pipefail

# shellcheck source=tests/vm/guest/job.sh
. /run/rect-vm/guest/job.sh
controllers=0 shares=() command=() # set by:
# shellcheck source=/dev/null
. "$here/settings"
PATH=$here/guest:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
export PATH RECT_RELAY=$here/ble-relay

for i in "${!shares[@]}"; do
  mkdir -p "/run/share$i"
  mount_share "share$i" "/run/share$i"
done
port=$(output_port)
{
  status=0
  if ((controllers)); then
    room start "$controllers" || { echo "cannot start the emulated controllers: $(room log | tail -n 3)"; status=125; }
  fi
  if ((status == 0)); then
    "${command[@]}"
    status=$?
  fi
} </dev/null >"${port:?}" 2>&1
report "$status"
