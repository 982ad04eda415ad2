#!/bin/bash
# First process of the guest after the host's root is mounted. Sets up a small system with Bluetooth, runs the command
# of `run`, reports its exit status and powers the machine off. Its own messages go to the console.
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
ip link set lo up || fail 'cannot start the loopback interface'
for i in "${!shares[@]}"; do
  mount_share "share$i" "${shares[i]}" || fail "${shares[i]} could not be shared"
done

port=$(output_port)
[[ -n $port ]] || fail 'the guest has no port for its output'

# Services of the host may have left files with process ids that are visible through the overlay.
rm -f /var/run/dbus/pid /run/dbus/pid
mkdir -p /run/dbus
dbus-daemon --system --fork || fail 'cannot start the D-Bus system bus'
if ((controllers)); then
  room start "$controllers" || fail "cannot start the emulated controllers: $(room log | tail -n 3)"
  bluetoothd start || fail "cannot start bluetoothd: $(bluetoothd log | tail -n 3)"
  for ((i = 0; i < controllers; i++)); do
    adapter wait "hci$i" || fail "hci$i does not come up: $(room log | tail -n 3)"
  done
fi

cd "$directory" || fail "$directory does not exist in the guest"
mkfifo /run/rect-output
cat /run/rect-output >"$port" &
cat=$!
export RECT_VM_UPTIME
read -r RECT_VM_UPTIME _ </proc/uptime
setsid "${command[@]}" </dev/null >/run/rect-output 2>&1 9>&-
status=$?
# Processes that the command left behind may keep its output open. The output of the command itself is read to its end.
for _ in {1..50}; do
  kill -0 "$cat" 2>/dev/null || break
  sleep 0.1
done
kill "$cat" 2>/dev/null
report "$status"
