"""Deletes plug-ins in a copy of the checkout, with all that need them, and runs the other tests
there.

python scripts/without.py friction              # the copy is removed afterwards
python scripts/without.py --all -- tests/core   # the core alone; what follows -- is for pytest
"""

import argparse
import importlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OWN = "hhr_dolfinx.plugins."


def manifests() -> dict[str, tuple[str, ...]]:
    """Our plug-ins, and what each needs."""
    folders = [
        path.parent.name for path in (ROOT / "hhr_dolfinx" / "plugins").glob("*/__init__.py")
    ]
    return {name: importlib.import_module(OWN + name).PLUGIN.needs for name in folders}


def deleted(names: list[str]) -> list[str]:
    """These plug-ins, and all that need one of them.

    Raises:
        SystemExit: for a plug-in that is not there.
    """
    known = manifests()
    if unknown := set(names) - known.keys():
        raise SystemExit(
            f"there is no plug-in {', '.join(sorted(unknown))}: plug-ins are "
            f"{', '.join(sorted(known))}"
        )
    gone = set(names)
    while more := {name for name, needs in known.items() if gone & set(needs)} - gone:
        gone |= more
    return sorted(gone)


def copy_without(names: list[str], target: Path) -> None:
    """Files of git and those that are not yet in it, without the folders of some plug-ins."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout.split("\0")  # fmt: skip
    folders = tuple(
        f"{place}/plugins/{name}/" for place in ("hhr_dolfinx", "tests") for name in names
    )
    for name in listed:
        if name and not name.startswith(folders) and (ROOT / name).exists():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)
    # the editable installation would find those of the checkout
    for name in ("forms", "geometries"):
        (target / "hhr_dolfinx" / name).symlink_to(target / name, target_is_directory=True)
    settings = target / "pyproject.toml"
    lines = settings.read_text(encoding="utf-8").splitlines(keepends=True)
    entries = re.compile(rf'^({"|".join(names)}) = "{re.escape(OWN)}')
    settings.write_text(
        "".join(line for line in lines if not entries.match(line)), encoding="utf-8"
    )
    subprocess.run(
        [sys.executable, "setup.py", "-q", "egg_info"], cwd=target, check=True, capture_output=True
    )


def main() -> int:
    """Run the tests, and return their exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("plugins", nargs="*", help="plug-ins to delete")
    parser.add_argument("--all", action="store_true", help="delete all of them")
    arguments, for_pytest = sys.argv[1:], []
    if "--" in arguments:
        place = arguments.index("--")
        arguments, for_pytest = arguments[:place], arguments[place + 1 :]
    options = parser.parse_args(arguments)
    gone = deleted(list(manifests()) if options.all else options.plugins)
    if not gone:
        parser.error("name a plug-in, or --all")
    with tempfile.TemporaryDirectory(prefix="without") as folder:
        target = Path(folder)
        copy_without(gone, target)
        print(f"without {', '.join(gone)}", flush=True)
        environment = os.environ | {"PYTHONPATH": str(target)}
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-p",
            "no:cacheprovider",
            *(for_pytest or ["-n", "auto"]),
        ]
        return subprocess.run(command, cwd=target, env=environment).returncode


if __name__ == "__main__":
    sys.exit(main())
