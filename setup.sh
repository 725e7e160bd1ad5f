#!/bin/sh
# Sets clcache up on a machine that has nothing of it, and shows that it works; may be run again at any time.
#
#   ./setup.sh         install clcache and, if none works, an OpenCL driver; render data/cornell into out/
#   ./setup.sh test    install the same and what the tests need; run the tests
#
# Python packages go to the active virtual environment, else to .venv beside this file. System packages (Debian, Ubuntu)
# are installed only as root or where sudo asks for no password. PYTHON=/path/to/python3 chooses the interpreter.
set -eu
cd "$(dirname "$0")"

say() { echo "setup: $*"; }
fail() { echo "setup: error: $*" >&2; exit 1; }
new_enough() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; }

case "${1-}" in
    '' | test) ;;
    *) fail "unknown argument '$1'; usage: ./setup.sh [test]" ;;
esac
[ "$(uname -s)" = Linux ] || fail "this script is for Linux; elsewhere: pip install . and your vendor's OpenCL driver"

# How to run a command as root without a question; empty for root itself.
if [ "$(id -u)" = 0 ]; then
    may_install=yes as_root=
elif sudo -n true 2>/dev/null; then
    may_install=yes as_root=sudo
else
    may_install=no as_root=
fi
command -v apt-get >/dev/null || may_install=no

apt_install() {
    [ $may_install = yes ] || return 1
    say "installing system packages: $*"
    $as_root apt-get -qq update &&
        $as_root env DEBIAN_FRONTEND=noninteractive apt-get -qq install -y --no-install-recommends "$@" >/dev/null
}

find_python() {
    for python in ${PYTHON:-python3 python3.14 python3.13 python3.12 python3.11}; do
        if command -v "$python" >/dev/null && new_enough "$python"; then
            return
        fi
    done
    fail "Python 3.11 or newer is needed; PYTHON=/path/to/python3 ./setup.sh names one that is not on the PATH"
}

make_venv() {
    find_python
    say "making a virtual environment in .venv"
    if "$python" -c 'import ensurepip, venv' 2>/dev/null; then
        "$python" -m venv .venv
        return
    fi
    # Debian and Ubuntu have this part of Python in a package of its own.
    package=$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
    if apt_install "$package"; then
        "$python" -m venv .venv
    elif "$python" -m pip --version >/dev/null 2>&1 && "$python" -m venv --without-pip .venv; then
        "$python" -m pip --python .venv/bin/python install -q pip
    else
        rm -rf .venv
        fail "$python cannot make virtual environments; as root: apt-get install $package"
    fi
}

# Does nothing when pip has done it before for these very requirements.
install_packages() {
    stamp="$venv/.clcache-installed$1"
    if ! cat setup.cfg pyproject.toml | cmp -s - "$stamp"; then
        say "installing Python packages into $venv"
        "$venv/bin/python" -m pip install -q --disable-pip-version-check -e ".$1"
        cat setup.cfg pyproject.toml >"$stamp"
    fi
}

driver_works() { report=$("$venv/bin/clcache" doctor 2>&1); }

install_driver() {
    driver_works && return
    say "no OpenCL driver works here; installing one"
    apt_install pocl-opencl-icd && driver_works && return
    if [ "$(uname -m)" = x86_64 ]; then
        say "installing Intel's OpenCL runtime for CPUs into $venv (a download of 270 MB)"
        install_packages '[intel]'
    fi
    driver_works || fail "no OpenCL driver works: $report"
}

venv=${VIRTUAL_ENV:-$PWD/.venv}
[ -x "$venv/bin/python" ] || make_venv
new_enough "$venv/bin/python" || fail "$venv has $("$venv/bin/python" -V 2>&1); Python 3.11 or newer is needed"
"$venv/bin/python" -c 'import pip' 2>/dev/null || "$venv/bin/python" -m ensurepip >/dev/null || fail "$venv has no pip"
install_packages ''
install_driver

if [ "${1-}" = test ]; then
    install_packages '[test]'
    command -v oclgrind >/dev/null || apt_install oclgrind || say "no oclgrind: the tests that need it are skipped"
    exec "$venv/bin/python" -m pytest -n auto --dist loadfile
fi
echo "$report"
"$venv/bin/clcache" render data/cornell/scene.toml -o out --png
say "the pictures are in out/; the command is $venv/bin/clcache"
