# Installs, uses, upgrades and purges the packages. `outside ROOT` runs first, in namespaces of its
# own, and enters ROOT to run `inside`.

say() {
    printf '\n== %s\n' "$*"
}

fail() {
    echo "failed: $*" >&2
    exit 1
}

outside() {
    mount --make-rprivate /
    # `ip netns exec` needs a root that is a mount point.
    mount --bind "$1" "$1"
    cd "$1"
    mount -t proc proc proc
    mount -t sysfs sysfs sys
    mount -t bpf -o mode=0700 bpf sys/fs/bpf
    mount -t tmpfs -o mode=755 run run
    mount -t tmpfs -o mode=755 dev dev
    for node in null zero full random urandom tty; do
        touch "dev/$node"
        mount --bind "/dev/$node" "dev/$node"
    done
    mkdir dev/shm
    mount -t tmpfs -o mode=1777 shm dev/shm
    ln -s /proc/self/fd dev/fd
    # systemd's folder, and a script in its place.
    mkdir -p run/systemd/system run/netns
    install -m 0755 root/systemctl.sh usr/bin/systemctl
    ip link set lo up
    exec chroot . /usr/bin/env -i PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root \
        LANG=C.UTF-8 DEBIAN_FRONTEND=noninteractive VERSIONS="$VERSIONS" sh -eu /root/trial.sh inside
}

# The files of the system, without what dpkg and programs in general write.
files() {
    find / -xdev \( -path /proc -o -path /sys -o -path /dev -o -path /run -o -path /tmp -o -path /root \
        -o -path /var/cache -o -path /var/log -o -path /var/lib/dpkg -o -path /var/lib/apt \) -prune -o -print |
        grep -vE '^/etc/(passwd|group|shadow|gshadow|subuid|subgid)-?$|^/etc/enabled-' | sort
}

far() {
    ip netns exec far "$@"
}

pid() {
    cat "/run/units/$1.service"
}

inside() {
    cd /root
    old=${VERSIONS% *}
    new=${VERSIONS#* }
    files >before

    say "install $old"
    apt-get -qq install -y ./old/*.deb >apt.log 2>&1 || { cat apt.log; fail "apt-get install"; }
    [ "$(dpkg-query -Wf '${Version}' gdp-switch)" = "$old" ] || fail "another version is installed"
    [ -z "$(ls /run/units 2>/dev/null)" ] || fail "something was started"
    [ "$(stat -c %U:%G:%a /etc/gdp)" = gdp:gdp:750 ] || fail "/etc/gdp: $(stat -c %U:%G:%a /etc/gdp)"
    files >installed
    grep -q /usr/share/man/man1/gdp-ctl-topic-echo.1.gz installed || fail "no manual page"
    bash -n /usr/share/bash-completion/completions/gdp-ctl
    bash -n /usr/share/bash-completion/completions/gdp-proxy

    say "up"
    ip netns add far
    ip link add e0 mtu 1500 type veth peer name f0 netns far
    ip address add 10.9.1.1/24 dev e0
    ip link set e0 up
    far ip address add 10.9.1.2/24 dev f0
    far ip link set f0 up
    far ip link set lo up
    far ethtool -K f0 tx off gro on >/dev/null
    gdp-ctl up --at 10.9.1.1 | tee up.txt
    grep -q 'Services  gdp-switch.service, gdp-join.service, gdp-proxy@home-server.service' up.txt ||
        fail "not as services"
    switch=$(pid gdp-switch)
    grep -q '^CapPrm:.*000000c000003000$' "/proc/$switch/status" || fail "$(grep Cap "/proc/$switch/status")"
    grep -q "^Uid:.$(id -u gdp)" "/proc/$switch/status" || fail "not as the user gdp"
    grep -q 'XDP: native on e0' /var/log/gdp-switch.service.log || fail "$(cat /var/log/gdp-switch.service.log)"
    [ "$(stat -c %U:%a /etc/gdp/home/domain.pem)" = root:600 ] || fail "the domain's key is not root's"
    ! setpriv --reuid gdp --regid gdp --clear-groups cat /etc/gdp/home/domain.pem 2>/dev/null ||
        fail "the services can read the domain's key"
    [ "$(stat -c %U:%G:%a /run/gdp/ctl.sock)" = gdp:gdp:660 ] || fail "$(stat /run/gdp/ctl.sock)"
    setpriv --reuid nobody --regid gdp --clear-groups env HOME=/nonexistent gdp-ctl status >/dev/null ||
        fail "a member of the group cannot use the socket"
    ! setpriv --reuid nobody --regid nogroup --clear-groups env HOME=/nonexistent gdp-ctl status >/dev/null 2>&1 ||
        fail "everybody can use the socket"

    say "invite and join"
    gdp-ctl invite here --expose /chatter | grep gdp1 >line
    gdp-proxy join <line | tee join.txt
    grep -q 'Running   as gdp-proxy.service' join.txt || fail "join did not start the service"
    for label in robot7 alice; do
        gdp-ctl invite "$label" --expose /chatter | grep gdp1 >line
        far gdp-proxy join --no-run --dir "/root/$label" <line >/dev/null
    done
    gdp-ctl robots
    gdp-ctl robots | grep -q 'here *online' || fail "this machine's own proxy is not online"

    say "a message"
    gdp-ctl name create --owner robot7/owner.pem --topic /n --type std_msgs/msg/String -o robot7/n.card >/dev/null
    gdp-ctl grant add robot7/n.card --key robot7/owner.pem --publish --entity robot7/proxy.pem -o robot7/n.ad >/dev/null
    gdp-ctl grant add robot7/n.card --key robot7/owner.pem --read --entity alice/proxy.pem -o alice/n.grant >/dev/null
    cp robot7/n.card alice
    far timeout 60 gdp-ctl topic echo /n --keyring alice --once >message 2>echo.err &
    reader=$!
    far timeout 60 gdp-ctl topic pub /n std_msgs/msg/String '{data: hello}' --keyring robot7 -1 -w 1 >/dev/null
    wait $reader
    grep -q 'data: hello' message || fail "no message: $(cat message echo.err)"
    cat message

    say "upgrade to $new under traffic"
    count=4000
    far timeout 120 gdp-ctl topic echo /n --keyring alice >messages 2>echo.err &
    reader=$!
    far timeout 100 gdp-ctl topic pub /n std_msgs/msg/String '{data: hello}' --keyring robot7 --rate 200 \
        --times $count -w 1 --qos-reliability best_effort >/dev/null 2>pub.err &
    writer=$!
    for _ in $(seq 300); do
        [ "$(grep -c hello messages)" -lt 200 ] || break
        sleep 0.1
    done
    [ "$(grep -c hello messages)" -ge 200 ] || fail "no traffic: $(cat echo.err pub.err)"
    apt-get -qq install -y ./new/*.deb >apt.log 2>&1 || { cat apt.log; fail "the upgrade"; }
    got=$(grep -c hello messages)
    [ "$got" -lt $count ] || fail "the upgrade came after the traffic"
    [ "$(dpkg-query -Wf '${Version}' gdp-switch)" = "$new" ] || fail "another version is installed"
    [ "$(pid gdp-switch)" != "$switch" ] || fail "the switch was not started again"
    wait $writer || fail "$(cat pub.err)"
    sleep 2
    kill $reader
    wait $reader || true
    got=$(grep -c hello messages)
    echo "$got of $count messages arrived, sent without repair"
    [ "$got" = $count ] || fail "messages are missing: $(cat echo.err; tail -20 /var/log/gdp-switch.service.log)"
    gdp-ctl xdp stats
    gdp-ctl status >/dev/null || fail "the new switch does not answer"

    say "purge"
    gdp-proxy leave
    apt-get -qq purge -y gdp-switch gdp-proxy gdp-cli >apt.log 2>&1 || { cat apt.log; fail "the purge"; }
    files >after
    diff before after || fail "these files are left"
    # Two files are the kernel's own.
    [ -z "$(ls -A /sys/fs/bpf | grep -vE '^(progs|maps)\.debug$')" ] || fail "pins are left: $(find /sys/fs/bpf)"
    [ -z "$(ps -u gdp -o pid=)" ] || fail "processes are left: $(ps -fu gdp)"
    ip -o link show e0 | grep -q xdp && fail "XDP is left"
    say "all of it works"
}

"$@"
