# shellcheck shell=bash
# Sourced by boot.sh and command.sh. Communicates with `run` through a folder that both can access.
here=/run/rect-vm

mount_share() { # TAG FOLDER
  mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000,cache=none "$1" "$2"
}
output_port() { # prints the device for the command's output to `run`; nothing if there is none
  local name
  for name in /sys/class/virtio-ports/*/name; do
    [[ $(<"$name") != rect.output ]] || { name=${name%/name}; echo "/dev/${name##*/}"; }
  done
}
report() { # STATUS: reports the exit status of the command and powers the machine off
  # After a kernel fault, the kernel kills the affected thread and continues; later results are meaningless.
  dmesg | grep -E ' (BUG|Oops)\b|kernel BUG|general protection fault' >"$here/kernel_faults" || rm -f "$here/kernel_faults"
  printf '%s\n' "$1" >"$here/status.new"
  mv "$here/status.new" "$here/status"
  off
}
off() {
  sync
  echo o >/proc/sysrq-trigger
  while :; do :; done # no file of the host may be read any more
}
