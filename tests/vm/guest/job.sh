# shellcheck shell=bash
# Sourced by boot.sh and command.sh: what the guest has to do with `run`, by the folder that both see.
here=/run/rect-vm

mount_share() { # TAG FOLDER
  mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000,cache=none "$1" "$2"
}
output_port() { # the device on which the command's words go to `run`; nothing if there is none
  local name
  for name in /sys/class/virtio-ports/*/name; do
    [[ $(<"$name") != rect.output ]] || { name=${name%/name}; echo "/dev/${name##*/}"; }
  done
}
report() { # STATUS: of the command; the machine is switched off
  # A kernel that went wrong kills the thread that was in it and goes on: whatever came of that says nothing.
  dmesg | grep -E ' (BUG|Oops)\b|kernel BUG|general protection fault' >"$here/kernel_faults" || rm -f "$here/kernel_faults"
  printf '%s\n' "$1" >"$here/status.new"
  mv "$here/status.new" "$here/status"
  off
}
off() {
  sync
  echo o >/proc/sysrq-trigger
  while :; do :; done # nothing may be read from the host any more
}
