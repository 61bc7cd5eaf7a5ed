#!/bin/sh
# In the place of systemctl(1), where no systemd runs: starts and stops units of the packages, by
# what their files say. A unit's process has the user, capabilities, environment and bind mounts.
set -eu
units=""
verb=""
for word in "$@"; do
    case "$word" in
    -*) ;;
    *.service) units="$units $word" ;;
    *) [ -n "$verb" ] || verb=$word ;;
    esac
done
mkdir -p /run/units
value() { # FILE KEY
    sed -n "s/^$2=//p" "$1" | head -1
}
stop() {
    if [ -f "/run/units/$1" ]; then
        pid=$(cat "/run/units/$1")
        kill "$pid" 2>/dev/null || true
        for _ in $(seq 100); do
            kill -0 "$pid" 2>/dev/null || break
            sleep 0.1
        done
        rm -f "/run/units/$1"
    fi
}
start() {
    instance=${1#*@}
    instance=$(echo "${instance%.service}" | tr - /)
    file=/usr/lib/systemd/system/$(echo "$1" | sed 's/@.*/@.service/')
    for setting in $(sed -n 's/^Environment=//p' "$file"); do
        export "${setting?}"
    done
    if grep -q '^RuntimeDirectory=gdp' "$file"; then
        install -d -o gdp -g gdp -m 0750 /run/gdp
        install -d -o gdp -g gdp -m 0700 /var/lib/gdp
    fi
    run=$(value "$file" ExecStart | sed "s|%I|$instance|; s|\${GDP_SWITCH_FILE}|${GDP_SWITCH_FILE:-}|")
    capabilities=-all
    for capability in $(value "$file" AmbientCapabilities); do
        capabilities="$capabilities,+$(echo "${capability#CAP_}" | tr '[:upper:]' '[:lower:]')"
    done
    bind=true
    if grep -q '^BindPaths=-/sys/fs/bpf/gdp-switch:/sys/fs/bpf$' "$file"; then
        bind='mount --bind /sys/fs/bpf/gdp-switch /sys/fs/bpf'
    fi
    # The mount namespace is the unit's own; what is mounted there stays there.
    # shellcheck disable=SC2016
    setsid unshare --mount --propagation slave sh -euc '
        '"$bind"'
        exec setpriv --reuid gdp --regid gdp --clear-groups --bounding-set "$1" --inh-caps "$1" \
            --ambient-caps "$1" --no-new-privs $2' sh "$capabilities" "$run" \
        >>"/var/log/$1.log" 2>&1 </dev/null &
    echo $! >"/run/units/$1"
    for _ in $(seq 300); do
        kill -0 "$(cat "/run/units/$1")" 2>/dev/null || { cat "/var/log/$1.log" >&2; return 1; }
        grep -qE 'ready: switch|join service is ready|attached to the switch' "/var/log/$1.log" && return 0
        sleep 0.1
    done
    echo "$1 is not ready" >&2
    return 1
}
expand() { # running units of each pattern
    for pattern in $units; do
        case "$pattern" in
        *\**) (cd /run/units && find . -name "$pattern" | sed 's|^./||') ;;
        *) echo "$pattern" ;;
        esac
    done
}
set -f
for unit in $(expand); do
    case "$verb" in
    enable) touch "/etc/enabled-$unit" ;;
    disable) rm -f "/etc/enabled-$unit" ;;
    stop) stop "$unit" ;;
    restart | start) stop "$unit"; : >"/var/log/$unit.log"; start "$unit" ;;
    try-restart) [ ! -f "/run/units/$unit" ] || { stop "$unit"; start "$unit"; } ;;
    is-active) [ -f "/run/units/$unit" ] && kill -0 "$(cat "/run/units/$unit")" ;;
    *) ;;
    esac
done
