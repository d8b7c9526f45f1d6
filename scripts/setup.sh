#!/bin/sh
# Makes .venv with everything the demos and tests need; a second call returns at once.
#
# 1. A Python that already has DOLFINx >= 0.9 (conda, apt) is used with its DOLFINx.
# 2. Otherwise a Python >= 3.12 is looked for and DOLFINx, PETSc and SLEPc are installed as a wheel.
#
# PYTHON=/path/to/python chooses the interpreter.
set -eu
cd "$(dirname "$0")/.."
venv=.venv
stamp=$venv/.ready
if [ -e "$stamp" ] && [ "$stamp" -nt pyproject.toml ] && [ "$stamp" -nt scripts/setup.sh ]; then exit 0; fi

say() { printf '%s\n' "$*" >&2; }

has_dolfinx() {
    "$1" -c 'import importlib.util as u
if u.find_spec("dolfinx_solver"): import dolfinx_solver
import petsc4py, slepc4py, mpi4py, dolfinx
raise SystemExit(tuple(map(int, dolfinx.__version__.split(".")[:2])) < (0, 9))' >/dev/null 2>&1
}

version_at_least() {
    "$1" -c "import sys; raise SystemExit(sys.version_info < (3, $2))" >/dev/null 2>&1
}

# every interpreter worth a try, the user's choice first
candidates() {
    [ -z "${PYTHON:-}" ] || printf '%s\n' "$PYTHON"
    printf '%s\n' python3 python python3.12 python3.13 python3.14
    for python in "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3.1[2-9]*/bin/python3; do printf '%s\n' "$python"; done
}

system_python='' python=''
for candidate in $(candidates); do
    path=$(command -v "$candidate") || continue
    if [ -z "$system_python" ] && has_dolfinx "$path"; then system_python=$path; fi
    # an activated pyenv shim without its version exits non-zero and is passed over
    if [ -z "$python" ] && version_at_least "$path" 12; then python=$path; fi
done

# libraries that gmsh and pyvista load at run time, by Debian package
missing=''
need_library() {
    if ! "${system_python:-$python}" -c "import ctypes; ctypes.CDLL('$1')" >/dev/null 2>&1; then missing="$missing $2"; fi
}

check_system() {
    command -v gcc >/dev/null 2>&1 || command -v cc >/dev/null 2>&1 || missing="$missing gcc"
    printf '#include <stdlib.h>\nint main(void){return 0;}\n' |
        "${CC:-cc}" -x c -fsyntax-only - >/dev/null 2>&1 || missing="$missing libc6-dev"
    headers=$("${system_python:-$python}" -c 'import sysconfig; print(sysconfig.get_path("include"))')
    [ -e "$headers/Python.h" ] || missing="$missing python3-dev"
    "${system_python:-$python}" -c 'import venv, ensurepip' >/dev/null 2>&1 || missing="$missing python3-venv"
    need_library libEGL.so.1 libegl1
    need_library libGL.so.1 libgl1
    need_library libGLU.so.1 libglu1-mesa
    need_library libXcursor.so.1 libxcursor1
    need_library libXft.so.2 libxft2
    need_library libXinerama.so.1 libxinerama1
    if [ -n "$missing" ]; then
        say "These system packages are missing:$missing"
        say "Install them, then call this again. On Debian and Ubuntu:"
        say "    sudo apt-get update && sudo apt-get install -y$missing"
        exit 1
    fi
}

if [ -z "$system_python" ] && [ -z "$python" ]; then
    say "No Python >= 3.12 and no installed DOLFINx were found."
    say "Get one of them, then call this again:"
    say "    Debian 13 or newer:  sudo apt-get install -y python3 python3-dev python3-venv"
    say "    Debian 12, others:   pyenv install 3.12"
    say "    conda:               conda create -n hhr -c conda-forge fenics-dolfinx slepc4py && conda activate hhr"
    say "or name an interpreter:  PYTHON=/path/to/python make test"
    exit 1
fi
check_system

rm -rf "$venv"
if [ -n "$system_python" ]; then
    say "Using the DOLFINx of $system_python"
    "$system_python" -m venv --system-site-packages "$venv"
    extras=test
else
    if [ "$(uname -sm)" != "Linux x86_64" ]; then
        say "The DOLFINx wheel is for x86-64 Linux; here ($(uname -sm)) install DOLFINx with conda:"
        say "    conda create -n hhr -c conda-forge fenics-dolfinx slepc4py && conda activate hhr"
        exit 1
    fi
    say "Installing DOLFINx, PETSc and SLEPc for $python into $venv (about 1 GB, a minute or two)"
    "$python" -m venv "$venv"
    extras=solver,test
fi
"$venv/bin/python" -m pip install --quiet --editable ".[$extras]"
"$venv/bin/python" -c 'import hhr_dolfinx.full_order.elastic, hhr_dolfinx.study.plots, hhr_dolfinx.geometries.hertz_half_discs' || {
    say "The installation does not work; the message above says why."
    exit 1
}
touch "$stamp"
