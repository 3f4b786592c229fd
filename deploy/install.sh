#!/bin/sh
# Installs the companion on the vehicle's computer: user, virtual environment, profiles, kernels, unit.
# Usage: sudo deploy/install.sh PROFILE.yaml [PYTHON]
# Safe to run again: an update replaces the program and keeps /etc/companion as it is.
set -eu

die() {
    echo "install: $*" >&2
    exit 1
}

[ $# -ge 1 ] || die "usage: sudo $0 PROFILE.yaml [PYTHON]"
profile=$1
python=${2:-python3}
prefix=/opt/companion
configuration=/etc/companion
cache=/var/cache/companion
source=$(cd "$(dirname "$0")/.." && pwd)
instance=$(basename "$profile" .yaml)

[ "$(id -u)" -eq 0 ] || die "must run as root"
[ -f "$profile" ] || die "$profile: no such file"
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 10))' || die "$python is older than 3.10"
if systemctl is-active --quiet "companion@$instance"; then
    die "companion@$instance is running; stop it first"
fi

echo "== user"
if ! id companion >/dev/null 2>&1; then
    useradd --system --home-dir /nonexistent --no-create-home --shell /usr/sbin/nologin companion
fi
if getent group dialout >/dev/null; then
    usermod -a -G dialout companion
fi

echo "== program in $prefix"
install -d -m 0755 "$prefix" "$prefix/deploy"
[ -x "$prefix/venv/bin/python" ] || "$python" -m venv "$prefix/venv"
"$prefix/venv/bin/pip" install --quiet --upgrade pip
"$prefix/venv/bin/pip" install --quiet --upgrade -c "$source/constraints.txt" "$source[report]"
# The version number alone does not tell pip that the source has changed.
"$prefix/venv/bin/pip" install --quiet --force-reinstall --no-deps "$source"
ln -sf "$prefix/venv/bin/companion" /usr/local/bin/companion
install -m 0644 "$source/deploy/network.md" "$prefix/deploy/network.md"

echo "== profiles in $configuration"
install -d -m 0755 "$configuration"
for file in "$source"/field_configs/uav_base.yaml "$source"/field_configs/profile.schema.json "$profile"; do
    target=$configuration/$(basename "$file")
    if [ -e "$target" ] && [ "${file##*.}" = yaml ]; then
        echo "kept $target"
    else
        install -m 0644 "$file" "$target"
    fi
done

echo "== kernel buffer for the LiDAR"
install -m 0644 "$source/deploy/90-companion.conf" /etc/sysctl.d/90-companion.conf
sysctl --quiet --load /etc/sysctl.d/90-companion.conf

echo "== kernels in $cache (some minutes on the first run)"
install -d -o companion -g companion -m 0750 "$cache"
runuser -u companion -- env NUMBA_CACHE_DIR="$cache" NUMBA_THREADING_LAYER=omp \
    "$prefix/venv/bin/companion" warmup

echo "== service"
install -m 0644 "$source/deploy/companion@.service" /etc/systemd/system/companion@.service
systemctl daemon-reload

echo "== check"
status=0
install -d -m 0755 /var/log/companion
install -d -o companion -g companion -m 0755 "/var/log/companion/$instance"
runuser -u companion -- env NUMBA_CACHE_DIR="$cache" LOGS_DIRECTORY="/var/log/companion/$instance" \
    "$prefix/venv/bin/companion" check "$configuration/$instance.yaml" --offline || status=$?
[ "$status" -eq 0 ] || die "the check failed with status $status"

echo "done. Start now and at every boot: systemctl enable --now companion@$instance"
