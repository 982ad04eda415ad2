#!/bin/bash
# Replaces boot.sh for `run --root`: hands the machine over to systemd of that root, which starts the command of `run`
# as a service after the boot.
set -uo pipefail

here=/run/rect-vm
mkdir -p /run/systemd/system/multi-user.target.wants
cat >/run/systemd/system/rect-vm.service <<'END'
[Unit]
Description=The command of tests/vm/run
After=multi-user.target dbus.service
[Service]
Type=oneshot
ExecStart=/bin/bash /run/rect-vm/guest/command.sh
TimeoutStartSec=infinity
END
ln -s ../rect-vm.service /run/systemd/system/multi-user.target.wants/
# Skip units that delay the boot: neither a network nor a login is needed.
for unit in getty.target systemd-networkd.service systemd-resolved.service systemd-timesyncd.service; do
  ln -sf /dev/null "/run/systemd/system/$unit"
done
echo wombat-1 >/proc/sys/kernel/hostname
chmod 755 "$here"
exec /lib/systemd/systemd --system --show-status=no
