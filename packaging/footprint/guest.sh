#!/bin/busybox sh
# /init of the emulated board: starts the simulated air and two routers, lets them link and carry a request, and measures
# them. What it finds it says on the console, a line each: `@rect {JSON}`; run reads them. However it ends, it ends with
# {"end": ...}, and the board is switched off.
#
# IDLE_S is on the kernel's command line, which becomes init's environment where the kernel has no use for it itself.
b=/bin/busybox
$b mount -t proc proc /proc
$b mount -t sysfs sys /sys
$b mount -t devtmpfs dev /dev
$b mount -t tmpfs tmp /tmp
$b mount -t cgroup2 groups /sys/fs/cgroup
$b --install -s /bin
export PATH=/bin HOME=/tmp RECT_AIR=/tmp/air.sock RUST_LOG=warn NO_COLOR=1
one_port=7447 two_port=7448

tell() { echo "@rect $*"; }
end() { # REASON, empty if all went well; one without quotes, as it becomes JSON
  if [ -n "$1" ]; then
    for log in /tmp/*.log; do sed "s|^|$log: |" "$log"; done
  fi
  tell "{\"end\": \"$1\"}"
  poweroff -f
  sleep 60 # the board's power goes when the watchdog says so; until then nothing more is to happen
}
uptime_cs() { # in hundredths of a second; 1 before them, as 09 would be a wrong octal number
  read -r up _ </proc/uptime
  echo $((${up%.*} * 100 + 1${up#*.} - 100))
}
within() { # SECONDS WHAT COMMAND...: waits until the command succeeds
  until_cs=$(($(uptime_cs) + $1 * 100)) waits_for=$2
  limit_s=$1
  shift 2
  until "$@"; do
    [ "$(uptime_cs)" -lt "$until_cs" ] || end "not within $limit_s s: $waits_for"
    usleep 10000
  done
}
number() { awk -v field="$2:" '$1 == field { print $2; found = 1 } END { exit !found }' "$1"; }
available_kb() { tell "{\"available_kb\": \"$1\", \"value\": $(number /proc/meminfo MemAvailable)}"; }

# Without a process of its own, as this is asked while a router starts, and would take from the time it has.
hex() { printf '%04X' "$1"; }
listens() { # PORT, as /proc/net/tcp writes it
  while read -r _ address _ state _; do
    [ "$address $state" != "0100007F:$1 0A" ] || return 0
  done </proc/net/tcp
  return 1
}
nobody_is_connected() { # at any of the routers: 01 is ESTABLISHED
  while read -r _ _ _ state _; do
    [ "$state" != 01 ] || return 1
  done </proc/net/tcp
}

start_router() { # NAME PORT MORE...: sets pid
  name=$1 port=$2 hex_port=$(hex "$2")
  shift 2
  mkdir "/sys/fs/cgroup/$name"
  {
    echo 0 >"/sys/fs/cgroup/$name/cgroup.procs"
    exec rect-router -c /simulation.json5 --cfg "plugins/rect/robot:\"$name\"" \
      -l "ble/sim-$name#name=$name" -l "tcp/127.0.0.1:$port" "$@"
  } >"/tmp/$name.log" 2>&1 &
  pid=$!
  within 60 "the router of $name accepts" listens "$hex_port"
  ready_cs=$(uptime_cs)
  used_us=$(cpu_us "$name")
  # Since boot and in hundredths of a second as well: CLK_TCK is 100 on every Linux.
  started_cs=$(cut -d' ' -f22 "/proc/$pid/stat")
  tell "{\"router\": \"$name\", \"start_ms\": $(((ready_cs - started_cs) * 10)), \"start_cpu_us\": $used_us}"
}
# utime and stime of /proc/PID/stat are the same in steps of 10 ms, which is more than a router takes in a minute.
cpu_us() { awk '$1 == "usage_usec" { print $2 }' "/sys/fs/cgroup/$1/cpu.stat"; }
wakeups() { # of all its threads since they began
  cat /proc/"$1"/task/*/status | awk '$1 == "voluntary_ctxt_switches:" { sum += $2 } END { print sum }'
}

linked() {
  rect air status | grep -q 'channel(s)' && rect-router status --router "tcp/127.0.0.1:$1" | grep -q wombat-1 &&
    rect-router status --router "tcp/127.0.0.1:$1" | grep -q wombat-2
}
asks() { rect request wombat-2 battery --timeout 2s --router "tcp/127.0.0.1:$1" 2>/dev/null | grep -q 'wombat-2: 83'; }
# Work leaves spare threads behind, which end by themselves when they have had nothing to do for 10 s.
no_thread_came_or_went() {
  now=$(echo /proc/"$one"/task/* /proc/"$two"/task/*)
  [ "$now" = "$threads" ] || threads=$now settled_cs=$(($(uptime_cs) + 1500))
  [ "$(uptime_cs)" -ge "$settled_cs" ]
}
gone() { ! kill -0 "$1" 2>/dev/null; }

while read -r module; do
  insmod "/modules/$module.ko" || end "module $module did not load"
done </modules/order
ip link set lo up || end 'there is no loopback'
# Returns when the kernel has random numbers to give.
head -c 1 /dev/random >/dev/null
tell "{\"cores\": $(nproc), \"memory_kb\": $(number /proc/meminfo MemTotal), \"release\": \"$(uname -r)\"}"
available_kb nothing

rect air serve --condition room --pdu 27 >/tmp/air.log 2>&1 &
# shellcheck disable=SC2317,SC2329 # within calls it
air_answers() { rect air status >/dev/null 2>&1; }
within 60 'the air answers' air_answers
available_kb air

start_router wombat-1 $one_port
one=$pid
start_router wombat-2 $two_port -e 'ble/wombat-1#adapter=sim-wombat-2'
two=$pid
within 120 'the two are linked and know each other' linked $one_port
within 120 'the two are linked and know each other' linked $two_port

rect serve battery --router "tcp/127.0.0.1:$two_port" -- echo 83 >/tmp/serve.log 2>&1 &
service=$!
within 120 'a request from one to the other is answered' asks $one_port
tell '{"request": "answered"}'
kill "$service"
within 30 'the service has ended' gone "$service"
within 30 'no program is connected any more' nobody_is_connected
available_kb routers

threads=''
within 120 'no thread has come or gone for 15 s' no_thread_came_or_went

mark() { # sets what the routers have used, and the moment
  from_cs=$(uptime_cs)
  one_us=$(cpu_us wombat-1) one_wakeups=$(wakeups "$one")
  two_us=$(cpu_us wombat-2) two_wakeups=$(wakeups "$two")
}
measure() { # NAME PID CPU_US WAKEUPS: those at the beginning
  status=/proc/$2/status rollup=/proc/$2/smaps_rollup
  tell "{\"router\": \"$1\", \"idle_cs\": $(($(uptime_cs) - from_cs))," \
    "\"cpu_us\": $(($(cpu_us "$1") - $3)), \"wakeups\": $(($(wakeups "$2") - $4))," \
    "\"rss_kb\": $(number "$status" VmRSS), \"hwm_kb\": $(number "$status" VmHWM), \"pss_kb\": $(number "$rollup" Pss)," \
    "\"own_kb\": $(number "$rollup" Anonymous), \"threads\": $(number "$status" Threads)}"
}
mark
sleep "$IDLE_S"
measure wombat-1 "$one" "$one_us" "$one_wakeups"
measure wombat-2 "$two" "$two_us" "$two_wakeups"
linked $one_port || end 'the link did not last'
end ''
