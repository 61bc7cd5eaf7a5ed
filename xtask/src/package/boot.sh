#!/bin/bash
# Uses the packages on a booted machine. The last line says whether all of it works.
set -u

fail() {
    echo "failed: $*"
    systemctl --no-pager status 'gdp-*' | head -60
    journalctl --no-pager -u 'gdp-*' | tail -40
    echo "THE TRIAL ENDS: failed"
    systemctl poweroff
    exit 1
}
active() {
    for _ in $(seq 90); do
        systemctl is-active --quiet "$1" && return
        sleep 1
    done
    fail "$1 is not active"
}

cd /root || exit 1
echo "== $(uname -r), $(systemctl --version | head -1)"
ip link add e0 type veth peer name f0
ip address add 10.9.1.1/24 dev e0
ip link set e0 up
ip link set f0 up
echo "== install"
apt-get -qq install -y ./old/*.deb >apt.log 2>&1 || { cat apt.log; fail "apt-get install"; }
systemctl is-active --quiet gdp-switch && fail "it runs before up"
echo "== up"
gdp-ctl up --at 10.9.1.1 || fail up
active gdp-switch
active gdp-join
active gdp-proxy@home-server
[ -S /run/gdp/proxy.sock ] || fail "the proxy has no admin socket"
systemctl show -P StatusText gdp-switch
systemctl show -P StatusText gdp-switch | grep -q 'XDP: native on e0' || fail "no XDP"
pid=$(systemctl show -P MainPID gdp-switch)
grep -E '^(Uid|CapPrm|CapEff|NoNewPrivs|Seccomp):' "/proc/$pid/status"
grep -q '^CapPrm:.*000000c000003000$' "/proc/$pid/status" || fail capabilities
find /sys/fs/bpf/gdp-switch -name 'xdp-*' | grep -q . || fail "nothing is pinned"
systemd-analyze security --no-pager gdp-switch gdp-join gdp-proxy | grep Overall
echo "== join"
gdp-ctl invite here --expose /chatter | grep gdp1 >line
gdp-proxy join <line || fail join
active gdp-proxy
systemctl reload gdp-proxy || fail reload
gdp-ctl robots || fail robots
echo "== message"
for label in robot7 alice; do
    gdp-ctl invite "$label" --expose /chatter | grep gdp1 >line
    gdp-proxy join --no-run --dir "/root/$label" <line >/dev/null || fail "join of $label"
done
{
    gdp-ctl name create --owner robot7/owner.pem --topic /n --type std_msgs/msg/String -o robot7/n.card
    gdp-ctl grant add robot7/n.card --key robot7/owner.pem --publish --entity robot7/proxy.pem -o robot7/n.ad
    gdp-ctl grant add robot7/n.card --key robot7/owner.pem --read --entity alice/proxy.pem -o alice/n.grant
    cp robot7/n.card alice
} >/dev/null || fail grants
timeout 120 gdp-ctl topic echo /n --keyring alice --once >message &
timeout 120 gdp-ctl topic pub /n std_msgs/msg/String '{data: hello}' --keyring robot7 -1 -w 1 >/dev/null || fail pub
wait
grep -q 'data: hello' message || fail "no message"
cat message
echo "== watchdog"
kill -STOP "$pid"
for _ in $(seq 90); do
    now=$(systemctl show -P MainPID gdp-switch)
    [ "$now" = "$pid" ] || [ "$now" = 0 ] || break
    sleep 1
done
journalctl --no-pager -u gdp-switch | grep -i watchdog | head -2
[ "$now" != "$pid" ] && [ "$now" != 0 ] || fail "the watchdog did not start a stopped switch again"
active gdp-switch
echo "== upgrade"
apt-get -qq install -y ./new/*.deb >apt.log 2>&1 || { cat apt.log; fail upgrade; }
active gdp-switch
active gdp-join
active gdp-proxy
active gdp-proxy@home-server
[ "$(systemctl show -P MainPID gdp-switch)" != "$now" ] || fail "the switch was not started again"
journalctl --no-pager "_PID=$(systemctl show -P MainPID gdp-switch)" | grep -q 'took over' || fail "the new switch did not take over"
echo "== leave and purge"
gdp-proxy leave || fail leave
systemctl is-active --quiet gdp-proxy && fail "the proxy runs on"
apt-get -qq purge -y gdp-switch gdp-proxy gdp-cli >apt.log 2>&1 || { cat apt.log; fail purge; }
[ ! -e /etc/gdp ] && [ ! -e /var/lib/gdp ] && [ ! -e /sys/fs/bpf/gdp-switch ] || fail "something is left"
ls /etc/systemd/system/multi-user.target.wants | grep gdp && fail "a unit is left enabled"
echo "THE TRIAL ENDS: good"
systemctl poweroff
