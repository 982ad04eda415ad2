#!/bin/bash
# First process of the guest once the host's root is in place: makes a small system with Bluetooth, runs the command of
# `run`, reports its status and switches the machine off. Its own words go to the console.
set -uo pipefail

# shellcheck source=tests/vm/guest/job.sh
. /run/rect-vm/guest/job.sh
fail() {
  printf '%s\n' "$*" >"$here/failure"
  off
}

controllers=0 directory=/ shares=() command=() # set by:
# shellcheck source=/dev/null
. "$here/settings"
PATH=$RECT_VM/guest:$PATH:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
export PATH

mkdir -p /dev/pts /dev/shm /run/lock
mount -t devpts devpts /dev/pts
mount -t tmpfs -o mode=1777 tmpfs /dev/shm
mount -t debugfs debugfs /sys/kernel/debug
ln -sfn /proc/self/fd /dev/fd
ln -sfn /proc/self/fd/0 /dev/stdin
ln -sfn /proc/self/fd/1 /dev/stdout
ln -sfn /proc/self/fd/2 /dev/stderr
chmod 1777 /tmp
ip link set lo up || fail 'the loopback interface does not come up'
for i in "${!shares[@]}"; do
  mount_share "share$i" "${shares[i]}" || fail "${shares[i]} could not be shared"
done

port=$(output_port)
[[ -n $port ]] || fail 'the guest has no port for its output'

# The host's own services may have left their ids in files that the overlay shows.
rm -f /var/run/dbus/pid /run/dbus/pid
mkdir -p /run/dbus
dbus-daemon --system --fork || fail 'the D-Bus system bus does not start'
if ((controllers)); then
  room start "$controllers" || fail "the emulated controllers do not start: $(room log | tail -n 3)"
  bluetoothd start || fail "bluetoothd does not start: $(bluetoothd log | tail -n 3)"
  for ((i = 0; i < controllers; i++)); do
    adapter wait "hci$i" || fail "hci$i does not come up: $(room log | tail -n 3)"
  done
fi

cd "$directory" || fail "$directory is not there in the guest"
mkfifo /run/rect-output
cat /run/rect-output >"$port" &
cat=$!
export RECT_VM_UPTIME
read -r RECT_VM_UPTIME _ </proc/uptime
setsid "${command[@]}" </dev/null >/run/rect-output 2>&1 9>&-
status=$?
# What the command left behind may hold its output open; what it wrote itself is read to the end.
for _ in {1..50}; do
  kill -0 "$cat" 2>/dev/null || break
  sleep 0.1
done
kill "$cat" 2>/dev/null
report "$status"
