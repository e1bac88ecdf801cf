#!/usr/bin/env bash
# Makes this machine ready: system packages, .venv, and the packages in it. Run it as often as you
# like: it does only what is missing, and says what it does.
#
#   tools/setup.sh           everything; `make quickstart` and `make test` begin with it
#   tools/setup.sh system    the system packages only, the one part that needs an administrator
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cd "$root"
venv=.venv
stamp=$venv/.setup-stamp
min_mesa=24.3 # older lavapipe lacks VK_KHR_external_semaphore_fd, and SAPIEN then finds no device
export PIP_DISABLE_PIP_VERSION_CHECK=1

say() { printf 'setup: %s\n' "$*"; }
die() {
    printf 'setup: %s\n' "$@" >&2
    exit 1
}

# Keeps a chatty command's output to itself, unless the command fails.
quietly() {
    local log status=0
    log=$(mktemp)
    "$@" >"$log" 2>&1 || status=$?
    [ $status = 0 ] || tail -n 40 "$log" >&2
    rm -f "$log"
    return $status
}

# ---------------------------------------------------------------- what is missing

libraries=$(PATH=$PATH:/sbin:/usr/sbin ldconfig -p 2>/dev/null || true)
has_library() { grep -q "^[[:space:]]*$1 " <<<"$libraries"; }
has_command() { command -v "$1" >/dev/null 2>&1; }
at_least() { dpkg --compare-versions "$1" ge "$2"; }

has_lavapipe() {
    # Without dpkg the version cannot be read here; `codediffuser doctor` renders a frame and tells.
    has_command dpkg-query || return 0
    local version
    version=$(dpkg-query -W -f='${Version}' mesa-vulkan-drivers 2>/dev/null) || return 1
    [ -n "$version" ] && at_least "$version" "$min_mesa"
}

has_browser() {
    has_command chromium || has_command chromium-browser || has_command google-chrome
}

# Wheels of the simulator's planner (mplib) exist for no Python newer than 3.12.
find_python() {
    local name path
    for name in python3.11 python3.12 python3; do
        path=$(command -v "$name") || continue
        if "$path" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' 2>/dev/null; then
            echo "$path"
            return 0
        fi
    done
    return 1
}

# Two dependencies (evdev, fpsample) come as source, so a first install compiles.
python_builds() {
    "$1" - <<'PY' 2>/dev/null
import ensurepip, pathlib, sysconfig, venv
raise SystemExit(not pathlib.Path(sysconfig.get_path("include"), "Python.h").is_file())
PY
}

# Debian packages that are missing, one a line, lavapipe aside.
missing_to_run() {
    has_library libvulkan.so.1 || echo libvulkan1
    has_library libGL.so.1 || echo libgl1
    has_library libEGL.so.1 || echo libegl1
    has_library libglib-2.0.so.0 || echo libglib2.0-0
    has_library libgomp.so.1 || echo libgomp1
    has_library libX11.so.6 || echo libx11-6
    has_command ffmpeg || echo ffmpeg
}

missing_to_install() {
    venv_is_current && return 0
    { has_command cc && has_command c++; } || echo build-essential
    local python
    if python=$(find_python); then
        if ! python_builds "$python"; then
            python=$("$python" -c 'import sys; print("python%d.%d" % sys.version_info[:2])')
            printf '%s\n' "$python" "$python-venv" "$python-dev"
        fi
    else
        python_packages
    fi
}

python_packages() {
    local name
    for name in python3.11 python3.12; do
        if [ -n "$(candidate "$name-venv")" ]; then
            printf '%s\n' "$name" "$name-venv" "$name-dev"
            return 0
        fi
    done
    echo python3.11 # apt then says that it has none
}

# ---------------------------------------------------------------- system packages

candidate() {
    LC_ALL=C apt-cache policy "$1" 2>/dev/null | awk '/Candidate:/ && $2 != "(none)" {print $2}'
}

apt_install() {
    say "apt-get install $*"
    DEBIAN_FRONTEND=noninteractive quietly apt-get install -y --no-install-recommends "$@"
}

add_backports() {
    local suite=$1 known form entry
    known=$(LC_ALL=C apt-cache policy)
    if ! grep -qF "n=$suite," <<<"$known"; then
        entry=$(bash tools/backports_entry.sh "${suite%-backports}")
        form=$(head -n 1 <<<"$entry")
        say "adding $suite to apt, from this machine's own entry"
        tail -n +2 <<<"$entry" >"/etc/apt/sources.list.d/codediffuser-backports.$form"
        quietly apt-get update
    fi
}

install_lavapipe() {
    local version codename=''
    version=$(candidate mesa-vulkan-drivers)
    if [ -n "$version" ] && at_least "$version" "$min_mesa"; then
        apt_install mesa-vulkan-drivers
        return 0
    fi
    # shellcheck disable=SC1091
    codename=$(. /etc/os-release && [ "$ID" = debian ] && echo "${VERSION_CODENAME:-}") || true
    [ -n "$codename" ] || die \
        "mesa-vulkan-drivers >= $min_mesa is needed; this system offers '${version:-none}'." \
        "Use Debian 12 or newer, Ubuntu 24.04 or newer, or install a newer Mesa by hand."
    add_backports "$codename-backports"
    apt_install -t "$codename-backports" mesa-vulkan-drivers
}

setup_system() {
    # Package names are asked of apt, which on a bare machine has no lists yet.
    if has_command apt-get && [ "$(id -u)" = 0 ] && [ -z "$(candidate libvulkan1)" ]; then
        quietly apt-get update
    fi
    local packages=() lavapipe=1 browser=1
    mapfile -t packages < <(missing_to_run && missing_to_install)
    has_lavapipe || lavapipe=0
    has_browser || browser=0
    if [ ${#packages[@]} = 0 ] && [ $lavapipe = 1 ] && [ $browser = 1 ]; then
        return 0
    fi
    local missing=("${packages[@]}")
    [ $lavapipe = 1 ] || missing+=("mesa-vulkan-drivers>=$min_mesa")
    if [ "$(id -u)" != 0 ] || ! has_command apt-get; then
        [ $browser = 1 ] || say "no Chromium found: tests marked 'gui' will be skipped"
        [ ${#missing[@]} = 0 ] && return 0
        say "missing system packages: ${missing[*]}"
        has_command apt-get || die "Install them with this system's package manager, then run again."
        die "An administrator must run:  sudo $root/tools/setup.sh system"
    fi
    say "missing system packages: ${missing[*]}$([ $browser = 1 ] || echo ' chromium')"
    quietly apt-get update
    [ ${#packages[@]} = 0 ] || apt_install "${packages[@]}"
    [ $lavapipe = 1 ] || install_lavapipe
    [ $browser = 1 ] || apt_install chromium || say "no Chromium: tests marked 'gui' will be skipped"
}

# ---------------------------------------------------------------- .venv

# The folder is part of the key: after a move the editable install would run the old folder's code.
stamp_now() {
    local files=(pyproject.toml tools/setup.sh)
    [ -f training/lerobot_plugin/pyproject.toml ] && files+=(training/lerobot_plugin/pyproject.toml)
    { echo "$root" && cat "${files[@]}"; } | sha256sum | cut -d' ' -f1
}

venv_is_current() {
    [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$(stamp_now)" ] && "$venv/bin/python" -c '' 2>/dev/null
}

pip_install() {
    say "pip install $*"
    "$venv/bin/python" -m pip install --progress-bar off "$@" |
        sed -u -n -E '/^ *(Downloading .*\.(whl|gz) |Building )/p'
}

make_venv() {
    if [ -e $venv ] && ! "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
        say "$venv has no working Python; making it anew"
        rm -rf "$venv"
    fi
    if [ ! -e $venv ]; then
        local python
        python=$(find_python) || die "Python 3.11 or 3.12 is needed and was not found."
        say "making $venv with $("$python" --version)"
        "$python" -m venv "$venv"
        pip_install --upgrade pip
    fi
}

# SAPIEN asks for opencv-python, LeRobot for opencv-python-headless, and both write into one folder
# cv2. Both stay installed, so that every requirement is met; the headless files have to win.
mend_cv2() {
    if "$venv/bin/python" - <<'PY' 2>/dev/null; then
import importlib.metadata, re, cv2
headless = importlib.metadata.version("opencv-python-headless")
no_windows = re.search(r"GUI:\s+NONE", cv2.getBuildInformation())
raise SystemExit(not (no_windows and headless.startswith(cv2.__version__)))
PY
        return 0
    fi
    local version folder
    version=$("$venv/bin/python" -c 'from importlib.metadata import version as v; print(v("opencv-python-headless"))')
    folder=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("platlib"))')/cv2
    rm -rf "$folder"
    pip_install --force-reinstall --no-deps "opencv-python-headless==$version"
}

# robomimic asks for egl_probe, which only CMake can build; its reader of datasets needs nothing that
# is not here. It lies in a folder of its own, where a test finds it and nothing else does.
robomimic_reader() {
    local folder=$venv/robomimic
    rm -rf "$folder"
    pip_install --no-deps --target "$folder" robomimic==0.3.0 ||
        say "no robomimic: the test that reads our exports with it will be skipped"
}

setup_python() {
    if venv_is_current; then
        return 0
    fi
    make_venv
    pip_install -e '.[dev]'
    if [ -f training/lerobot_plugin/pyproject.toml ]; then
        pip_install --no-deps -e training/lerobot_plugin
    fi
    mend_cv2
    robomimic_reader
    "$venv/bin/python" -m pip check
    stamp_now >"$stamp"
}

# ----------------------------------------------------------------

case "${1:-all}" in
system) setup_system ;;
all)
    setup_system
    setup_python
    say "ready ($("$venv/bin/python" --version), $root/$venv)"
    ;;
*) die "unknown argument '$1'; use no argument, or 'system'" ;;
esac
