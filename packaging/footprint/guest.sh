#!/bin/busybox sh
# /init of the emulated board: starts the simulated air and two linked routers, sends a request between them, and measures the
# routers. Results are written to the console, one line `@rect {JSON}` each, which `run` reads. The last line is always
# {"end": ...}; then the board is switched off.
#
# IDLE_S, METHOD (the method of the link) and ONLY (`video` or `recording`, empty for everything) are given on the kernel's command line: parameters unknown to the kernel
# become environment variables of init.
b=/bin/busybox
$b mount -t proc proc /proc
$b mount -t sysfs sys /sys
$b mount -t devtmpfs dev /dev
$b mount -t tmpfs tmp /tmp
$b mount -t cgroup2 groups /sys/fs/cgroup
$b --install -s /bin
export PATH=/bin HOME=/tmp RECT_AIR=/tmp/air.sock RUST_LOG=warn NO_COLOR=1
one_port=7447 two_port=7448
few=100 many=1100

report() { echo "@rect $*"; }
end() { # REASON: empty on success; must not contain quotes, because it becomes a JSON string
  if [ -n "$1" ]; then
    for log in /tmp/*.log; do sed "s|^|$log: |" "$log"; done
  fi
  report "{\"end\": \"$1\"}"
  poweroff -f
  sleep 60 # the watchdog switches the board off a moment later; nothing else may happen before
}
uptime_cs() { # prints hundredths of a second since boot; a 1 precedes the fraction, because 09 is an invalid octal number
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
available_kb() { report "{\"available_kb\": \"$1\", \"value\": $(number /proc/meminfo MemAvailable)}"; }

# These functions start no processes, which would use processor time while the start of a router is measured.
hex() { printf '%04X' "$1"; }
listens() { # PORT, in hexadecimal as in /proc/net/tcp
  while read -r _ address _ state _; do
    [ "$address $state" != "0100007F:$1 0A" ] || return 0
  done </proc/net/tcp
  return 1
}
no_program_is_connected() { # to any router; the state 01 is ESTABLISHED
  while read -r _ address _ state _; do
    case "$address $state" in *":$one_hex 01" | *":$two_hex 01") return 1 ;; esac
  done </proc/net/tcp
}

one_hex=$(hex $one_port) two_hex=$(hex $two_port)

start_router() { # NAME PORT MORE...: sets pid
  name=$1 port=$2 hex_port=$(hex "$2")
  shift 2
  mkdir "/sys/fs/cgroup/$name"
  {
    echo 0 >"/sys/fs/cgroup/$name/cgroup.procs"
    exec rect-router -c /simulation.json5 --cfg "plugins/rect/robot:\"$name\"" \
      -l "$METHOD/sim-$name#name=$name;secret=/tmp/secret" -l "tcp/127.0.0.1:$port" "$@"
  } >"/tmp/$name.log" 2>&1 &
  pid=$!
  within 60 "the router of $name accepts" listens "$hex_port"
  ready_cs=$(uptime_cs)
  used_us=$(cpu_us "$name")
  # Time since boot, also in hundredths of a second: CLK_TCK is 100 on every Linux.
  started_cs=$(cut -d' ' -f22 "/proc/$pid/stat")
  report "{\"router\": \"$name\", \"start_ms\": $(((ready_cs - started_cs) * 10)), \"start_cpu_us\": $used_us}"
}
# utime and stime of /proc/PID/stat have a resolution of only 10 ms, more than a router uses in a minute.
cpu_us() { awk '$1 == "usage_usec" { print $2 }' "/sys/fs/cgroup/$1/cpu.stat"; }
wakeups() { # PID: number of wake-ups of all its threads
  cat /proc/"$1"/task/*/status | awk '$1 == "voluntary_ctxt_switches:" { sum += $2 } END { print sum }'
}

linked() {
  rect air status | grep -q 'channel(s)' && rect-router status --router "tcp/127.0.0.1:$1" | grep -q wombat-1 &&
    rect-router status --router "tcp/127.0.0.1:$1" | grep -q wombat-2
}
paths_are_ready() { # PORT: both paths of an `any` link
  rect connections --router "tcp/127.0.0.1:$1" | grep -q 'paths: .*ble.*tcp'
}
request_is_answered() { rect request wombat-2 battery --timeout 2s --router "tcp/127.0.0.1:$1" 2>/dev/null | grep -q 'wombat-2: 83'; }
# Spare threads end after they have been idle for 10 s.
thread_counts_are_stable() {
  now=$(echo /proc/"$one"/task/* /proc/"$two"/task/*)
  [ "$now" = "$threads" ] || threads=$now settled_cs=$(($(uptime_cs) + 1500))
  [ "$(uptime_cs)" -ge "$settled_cs" ]
}
has_ended() { ! kill -0 "$1" 2>/dev/null; }

while read -r module; do
  insmod "/modules/$module.ko" || end "module $module did not load"
done </modules/order
ip link set lo up || end 'cannot enable the loopback interface'
# Blocks until the kernel's random number generator is ready.
head -c 1 /dev/random >/dev/null
report "{\"cores\": $(nproc), \"memory_kb\": $(number /proc/meminfo MemTotal), \"release\": \"$(uname -r)\"}"
available_kb nothing

echo 'team:the secret of the team' >/tmp/secret
chmod 600 /tmp/secret

measures() { [ -z "$ONLY" ] || [ "$ONLY" = "$1" ]; }
if measures video; then
  video_cost >/tmp/video.log 2>&1 || end 'cannot measure the video'
  while read -r line; do report "$line"; done </tmp/video.log
fi
if measures recording; then
  for writer in rect mcap; do
    record_cost $writer /tmp/match.mcap >/tmp/record.log 2>&1 || end 'cannot measure a recording'
    report "$(cat /tmp/record.log)"
    rm /tmp/match.mcap
  done
fi
[ -z "$ONLY" ] || end ''
ciphers >/tmp/ciphers.log 2>&1 || end 'cannot measure the ciphers'
while read -r line; do report "$line"; done </tmp/ciphers.log

rect air serve --condition room --pdu 27 >/tmp/air.log 2>&1 &
# shellcheck disable=SC2317,SC2329 # called by within
air_answers() { rect air status >/dev/null 2>&1; }
within 60 'the air answers' air_answers
if [ "$METHOD" = any ]; then
  rect wifi serve >/tmp/wifi.log 2>&1 &
  within 60 'the Wi-Fi answers' rect wifi on
fi
available_kb air

start_router wombat-1 $one_port
one=$pid
start_router wombat-2 $two_port -e "$METHOD/wombat-1#adapter=sim-wombat-2;secret=/tmp/secret"
two=$pid
within 120 'the first router knows the second' linked $one_port
within 120 'the second router knows the first' linked $two_port

if [ "$METHOD" = any ]; then
  within 120 'the link has both paths' paths_are_ready $one_port
fi

rect serve battery --router "tcp/127.0.0.1:$two_port" -- echo 83 >/tmp/serve.log 2>&1 &
service=$!
within 120 'a request between the robots is answered' request_is_answered $one_port
report '{"request": "answered"}'
kill "$service"
within 30 'the service has ended' has_ended "$service"
within 30 'no program is connected any more' no_program_is_connected
available_kb routers

threads=''
within 120 'the number of threads has not changed for 15 s' thread_counts_are_stable

start_measuring() { # records the time and the counters of both routers
  from_cs=$(uptime_cs)
  one_us=$(cpu_us wombat-1) one_wakeups=$(wakeups "$one")
  two_us=$(cpu_us wombat-2) two_wakeups=$(wakeups "$two")
}
measure() { # NAME PID CPU_US WAKEUPS: the counters at the beginning
  status=/proc/$2/status rollup=/proc/$2/smaps_rollup
  report "{\"router\": \"$1\", \"idle_cs\": $(($(uptime_cs) - from_cs))," \
    "\"cpu_us\": $(($(cpu_us "$1") - $3)), \"wakeups\": $(($(wakeups "$2") - $4))," \
    "\"rss_kb\": $(number "$status" VmRSS), \"hwm_kb\": $(number "$status" VmHWM), \"pss_kb\": $(number "$rollup" Pss)," \
    "\"own_kb\": $(number "$rollup" Anonymous), \"threads\": $(number "$status" Threads)}"
}
start_measuring
sleep "$IDLE_S"
measure wombat-1 "$one" "$one_us" "$one_wakeups"
measure wombat-2 "$two" "$two_us" "$two_wakeups"
linked $one_port || end 'the link was lost during the measurement'

# Messages between two programs of the first robot, one after the other. The router's share is the difference between many and
# few messages, so that the connecting of the programs does not count.
exchange() { # LIBRARY MESSAGES: sets router_us, the processor time of the router
  before_us=$(cpu_us wombat-1)
  message_cost "$1" receive "tcp/127.0.0.1:$one_port" "$2" >/tmp/receive.log 2>&1 &
  receiver=$!
  message_cost "$1" publish "tcp/127.0.0.1:$one_port" "$2" >/tmp/publish.log 2>&1 || end "$1 cannot publish"
  wait "$receiver" || end "$1 cannot receive"
  within 30 'no program is connected any more' no_program_is_connected
  router_us=$(($(cpu_us wombat-1) - before_us))
}
for library in rect zenoh; do
  exchange $library $few
  few_us=$router_us
  exchange $library $many
  cat /tmp/receive.log /tmp/publish.log | while read -r line; do report "$line"; done
  report "{\"library\": \"$library\", \"role\": \"router\", \"us\": $(((router_us - few_us) / (many - few)))}"
done
# The dashboard at the first router, with one browser, which sends what a browser sends to open the connection.
mkdir /sys/fs/cgroup/dashboard
{
  echo 0 >/sys/fs/cgroup/dashboard/cgroup.procs
  exec rect dashboard --router "tcp/127.0.0.1:$one_port" --listen 127.0.0.1:8080
} >/tmp/dashboard.log 2>&1 &
dashboard=$!
page_hex=$(hex 8080)
within 60 'the dashboard accepts' listens "$page_hex"
{
  printf 'GET /socket HTTP/1.1\r\nHost: 127.0.0.1:8080\r\nOrigin: http://127.0.0.1:8080\r\nConnection: Upgrade\r\n'
  printf 'Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n'
  sleep $((IDLE_S * 3))
} | nc 127.0.0.1 8080 >/tmp/page.bin &
# shellcheck disable=SC2317,SC2329 # called by within
fleet_is_shown() { grep -q 'wombat-2' /tmp/page.bin; }
within 60 'the page shows the fleet' fleet_is_shown
sleep 15
from_cs=$(uptime_cs) used_us=$(cpu_us dashboard)
sleep "$IDLE_S"
rollup=/proc/$dashboard/smaps_rollup
report "{\"program\": \"dashboard\", \"idle_cs\": $(($(uptime_cs) - from_cs)), \"cpu_us\": $(($(cpu_us dashboard) - used_us))," \
  "\"pss_kb\": $(number "$rollup" Pss), \"own_kb\": $(number "$rollup" Anonymous)," \
  "\"threads\": $(number "/proc/$dashboard/status" Threads)}"
end ''
