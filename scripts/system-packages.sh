#!/bin/sh
# What pip cannot bring: Python's venv module, and an OpenGL that draws without a screen. Installs what is missing where it
# may (root, or sudo without a password); elsewhere prints the one line to type and fails. Does nothing when all is there.
set -u
python=${1:-python3}

any() { # whether one of the files exists
    for file; do [ -e "$file" ] && return 0; done
    return 1
}

missing=""
"$python" -c 'import ensurepip, venv' 2>/dev/null || missing="$missing python3-venv"
any /usr/lib/*/libEGL.so.1 /usr/lib64/libEGL.so.1 /usr/lib/libEGL.so.1 || missing="$missing libegl1"
any /usr/lib/*/libOpenGL.so.0 /usr/lib/*/libGL.so.1 /usr/lib64/libOpenGL.so.0 /usr/lib64/libGL.so.1 || missing="$missing libopengl0"
any /usr/lib/*/dri/*_dri.so /usr/lib64/dri/*_dri.so /usr/lib/dri/*_dri.so /usr/share/glvnd/egl_vendor.d/*nvidia*.json ||
    missing="$missing libgl1-mesa-dri"
[ -z "$missing" ] && exit 0

if ! command -v apt-get >/dev/null 2>&1; then
    echo "Missing:$missing (as Debian calls them). Install their counterparts with your package manager;" >&2
    echo "on Fedora: sudo dnf install -y python3 mesa-libEGL libglvnd-opengl mesa-dri-drivers" >&2
    exit 1
fi
install="apt-get install -y --no-install-recommends$missing"
if [ "$(id -u)" = 0 ]; then
    as_root=""
elif sudo -n true 2>/dev/null; then
    as_root="sudo -n"
else
    echo "Missing system packages. Type this line once, then the same command again:" >&2
    echo "    sudo apt-get update && sudo $install" >&2
    exit 1
fi
echo "Installing system packages:$missing"
export DEBIAN_FRONTEND=noninteractive
# The lists may be missing or old: then once more after an update. The two variables are words, hence no quotes.
$as_root $install 2>/dev/null || { $as_root apt-get update && $as_root $install; }
