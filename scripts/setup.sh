#!/bin/sh
# Makes .venv with everything the demos and tests need; a second call returns at once.
#
# 1. A Python that already has DOLFINx >= 0.9 (conda, apt) is used with its DOLFINx.
# 2. Otherwise a Python >= 3.12 is looked for and DOLFINx, PETSc and SLEPc are installed as a wheel.
#
# PYTHON=/path/to/python chooses the interpreter. HHR_CI=1 also asks for what lets every test run: node, jsdom, Chromium,
# CalculiX and the programs of the extra "ci". What goes on is said in whole lines, so that a log can keep it; all that pip said is
# in .venv/pip.log.
set -eu
cd "$(dirname "$0")/.."
venv=.venv
stamp=$venv/.ready
also=${HHR_CI:+,ci}
# the stamp names the extras that were installed: an environment without those of continuous integration is not enough
if [ -e "$stamp" ] && [ "$stamp" -nt pyproject.toml ] && [ "$stamp" -nt scripts/setup.sh ] &&
    { [ -z "$also" ] || grep -q "$also" "$stamp"; }; then exit 0; fi

say() { printf '%s\n' "$*" >&2; }

# a DOLFINx that is new enough and has real numbers
has_dolfinx() {
    "$1" -c 'import importlib.util as u
if u.find_spec("dolfinx_solver"): import dolfinx_solver
import dolfinx, mpi4py, numpy, slepc4py
from petsc4py import PETSc
new = tuple(map(int, dolfinx.__version__.split(".")[:2])) >= (0, 9)
raise SystemExit(not new or numpy.issubdtype(PETSc.ScalarType, numpy.complexfloating))' >/dev/null 2>&1
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

begin=$(date +%s)
say "Set-up 1 of 3: looking for Python, DOLFINx and system libraries"
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
    if [ -n "$also" ]; then
        command -v node >/dev/null 2>&1 || missing="$missing nodejs"
        [ -e /usr/share/nodejs/jsdom ] || missing="$missing node-jsdom"
        command -v chromium >/dev/null 2>&1 || missing="$missing chromium"
        command -v ccx >/dev/null 2>&1 || missing="$missing calculix-ccx"
    fi
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

# what is imported is compiled then, and most of what is installed never is: compiling all of it takes longer than the tests that need it
# pip's lines with sizes as they come, the whole in a file; a bar would fill a log with carriage returns
install() {
    log=$venv/pip.log status=$venv/pip.status
    {
        code=0
        "$venv/bin/python" -m pip install --no-compile --progress-bar off --disable-pip-version-check --editable ".[$1]" 2>&1 ||
            code=$?
        echo "$code" >"$status"
    } | tee "$log" | while IFS= read -r line; do
        line=${line#"${line%%[! ]*}"}
        case $line in
            Downloading*" MB)" | Downloading*" GB)" | "Using cached"*" MB)" | "Using cached"*" GB)") say "    $line" ;;
            "Installing collected packages"*) say "    unpacking all of them, without a word" ;;
        esac
    done
    [ "$(cat "$status")" = 0 ] && return
    say "pip could not install what is needed; its last lines (all are in $log):"
    tail -n 15 "$log" >&2
    exit 1
}

if [ -e "$venv" ] && [ ! -e "$venv/pip.log" ]; then
    say "$PWD/$venv was not made by this set-up, which would have to remove it: move it elsewhere, or remove it"
    exit 1
fi
# metadata that an earlier set-up left beside the sources would hide the plug-ins of this one
rm -rf "$venv" hhr_dolfinx.egg-info
mkdir "$venv"
: >"$venv/pip.log" # its mark, from the start
if [ -n "$system_python" ]; then
    say "Set-up 2 of 3: the DOLFINx of $system_python is used; installing the rest into $venv"
    say "    (up to 440 MB to download, 1.7 GB on disk, two minutes)"
    "$system_python" -m venv --system-site-packages "$venv"
    extras=all,test$also
else
    if [ "$(uname -sm)" != "Linux x86_64" ]; then
        say "The DOLFINx wheel is for x86-64 Linux; here ($(uname -sm)) install DOLFINx with conda:"
        say "    conda create -n hhr -c conda-forge fenics-dolfinx slepc4py && conda activate hhr"
        exit 1
    fi
    say "Set-up 2 of 3: installing DOLFINx, PETSc, SLEPc and the rest for $python into $venv"
    say "    (520 MB to download, 1.9 GB on disk, two minutes)"
    "$python" -m venv "$venv"
    extras=all,solver,test$also
fi
install "$extras"
say "Set-up 3 of 3: trying what was installed"
# 'from dolfinx import mesh' may be the first line of a program, before hhr_dolfinx
"$venv/bin/python" hhr_dolfinx/solver_first.py >/dev/null
"$venv/bin/python" -c 'from dolfinx import mesh
import hhr_dolfinx, hhr_dolfinx.geometries.hertz_half_discs
from hhr_dolfinx import registry
for name in hhr_dolfinx.__all__: getattr(hhr_dolfinx, name)
for place in registry.named("tools").values(): registry.load(place)' || {
    say "The installation does not work; the message above says why."
    exit 1
}
[ ! -f hhr_dolfinx/plugins/scene_checks/doctor.py ] || "$venv/bin/python" -m hhr_dolfinx.plugins.scene_checks.doctor | while IFS= read -r line; do say "    $line"; done
printf '%s\n' "$extras" >"$stamp"
say "Set up in $(($(date +%s) - begin)) s: $(du -sm "$venv" | cut -f1) MB in $venv"
