#!/bin/sh
# Dumps what a base commit and the checkout give, and compares; `make same` calls it.
#
# BASE is the base, by default the commit of scripts/same_base.txt, whose known differences are in
# scripts/same_allowed.txt; ALLOW names another file of them. ONLY='*friction*' takes some kinds of models alone.
set -eu
cd "$(dirname "$0")/.."
root=$(pwd)
python=$root/.venv/bin/python
[ -x "$python" ] || sh scripts/setup.sh
known=$(git rev-parse --verify "$(cat scripts/same_base.txt)^{commit}")
base=$(git rev-parse --verify "${BASE:-$known}^{commit}")
allow=${ALLOW:-}
if [ -z "$allow" ] && [ "$base" = "$known" ]; then allow=scripts/same_allowed.txt; fi

folder=$(mktemp -d "${TMPDIR:-/tmp}/same_XXXXXX")
clean() {
    git worktree remove --force "$folder/base" 2>/dev/null || true
    rm -rf "$folder"
    git worktree prune
}
trap clean EXIT
trap 'exit 1' HUP INT TERM

echo "the checkout beside $(git log -1 --format='%h %s' "$base")" >&2
git worktree add --quiet --detach "$folder/base" "$base"
# plug-ins of the base by its own names
(cd "$folder/base" && "$python" setup.py -q egg_info)
PYTHONPATH=$folder/base "$python" scripts/same.py dump "$folder/base.npz" --only "${ONLY:-*}"
PYTHONPATH=$root "$python" scripts/same.py dump "$folder/checkout.npz" --only "${ONLY:-*}"
"$python" scripts/same.py compare "$folder/base.npz" "$folder/checkout.npz" ${allow:+--allow "$allow"}
