"""Compare answers, gradients, marches and files of all kinds of models between two commits, bit by
bit.

    make same                                  # the checkout with the commit of
    scripts/same_base.txt make same BASE=main                        # with another commit, of which
    no difference is allowed PYTHONPATH=TREE python scripts/same.py dump OUT.npz [--only
    '*friction*'] python scripts/same.py compare A.npz B.npz [--allow scripts/same_allowed.txt]
    [--all]

``dump`` records the package of the first tree on PYTHONPATH, ``compare`` prints what differs and
ends with 1 if that is not allowed. The kinds of models are in ``same_kinds.py``. A line of a file
of allowed differences holds a pattern of names, the largest relative difference, or ``missing``,
and the reason:

    HHR, inelastic*/solve*/stress*  |  1e-13  |  a quotient in the place of a product
"""

from __future__ import annotations

import os

# before any library of linear algebra is loaded: more threads sum up in another order
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import importlib
import importlib.metadata
import importlib.util
import json
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

HEADER = "header"
BY_CONTENT = ("/file/arrays/", "/memory/")
"""Arrays below these are equal if their commit has one of the same bits there, whatever its
name.
"""
MAY_SHRINK = "/bytes"
"""Sizes that may fall."""
SHOWN = 8
"""Rows of a kind that are printed without ``--all``, the largest differences first."""
ALIKE = ("equal", "refused")
"""Outcomes of what does not differ."""
PACKAGES = ("hhr_dolfinx", "hhr_dolfinx.geometries", "hhr_dolfinx.forms")


# ---------------------------------------------------------------- the package of a tree


class TreeDistribution(importlib.metadata.Distribution):
    """The distribution of a tree as ``pyproject.toml`` describes it: what is installed has plug-ins
    of another tree.
    """

    def __init__(self, tree: Path, project: dict[str, Any]) -> None:
        self._tree = tree
        groups = project.get("entry-points", {})
        lines = [
            f"[{group}]\n" + "\n".join(f"{key} = {value}" for key, value in groups[group].items())
            for group in groups
        ]
        name, version = project.get("name", PACKAGES[0]), project.get("version", "0")
        self._texts = {
            "METADATA": f"Name: {name}\nVersion: {version}\n",
            "entry_points.txt": "\n".join(lines),
        }

    def read_text(self, filename: str) -> str | None:
        """Text of a file of its metadata, None if there is none."""
        return self._texts.get(filename)

    def locate_file(self, path: Any) -> Path:
        """Path of a file of the tree."""
        return self._tree / path


class TreeFinder:
    """Finds the packages and plug-ins of one tree, before those that the environment has installed.

    Args:
        tree: root of a checkout; ``pyproject.toml`` says where its packages lie.
    """

    def __init__(self, tree: Path) -> None:
        with (tree / "pyproject.toml").open("rb") as file:
            settings = tomllib.load(file)
        folders = settings.get("tool", {}).get("setuptools", {}).get("package-dir", {})
        self._places = {name: tree / folder for name, folder in folders.items() if name}
        self._places.setdefault("hhr_dolfinx", tree / "hhr_dolfinx")
        self._distribution = TreeDistribution(tree, settings.get("project", {}))

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """Specification of a package of the tree, None of anything else."""
        folder = self._places.get(name)
        if folder is None or not (folder / "__init__.py").exists():
            return None
        return importlib.util.spec_from_file_location(
            name, folder / "__init__.py", submodule_search_locations=[str(folder)]
        )

    def find_distributions(self, context: Any) -> list[importlib.metadata.Distribution]:
        """The distribution of the tree, if that or all are sought."""
        return [self._distribution] if context.name in (None, *PACKAGES) else []


def load_tree(tree: Path) -> None:
    """Load the package of a tree.

    Raises:
        RuntimeError: if it came from elsewhere.
    """
    sys.meta_path[:] = [finder for finder in sys.meta_path if "_EditableFinder" not in repr(finder)]
    sys.meta_path.insert(0, TreeFinder(tree))  # type: ignore[arg-type]
    for name in PACKAGES:
        found = Path(importlib.import_module(name).__file__ or "").resolve()
        if not found.is_relative_to(tree.resolve()):
            raise RuntimeError(f"{name} was loaded from {found} and not from {tree}")


def tree_on_path() -> Path:
    """The first tree on PYTHONPATH; else the checkout of this script."""
    given = [Path(item) for item in os.environ.get("PYTHONPATH", "").split(os.pathsep) if item]
    trees = [item for item in given if (item / "hhr_dolfinx" / "__init__.py").exists()]
    return trees[0] if trees else Path(__file__).resolve().parents[1]


# ---------------------------------------------------------------- dumps


class Dump(NamedTuple):
    """What one commit gives.

    Attributes:
        arrays: by name.
        errors: package, type and message of what ended in one, by name.
    """

    arrays: dict[str, np.ndarray]
    errors: dict[str, str]

    def write(self, path: Path) -> None:
        """Write one ``.npz``."""
        header = np.array(json.dumps({"errors": self.errors}))
        with path.open("wb") as file:
            np.savez(file, allow_pickle=False, **{HEADER: header}, **self.arrays)

    @classmethod
    def read(cls, path: Path) -> Dump:
        """Read one."""
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files if name != HEADER}
            return cls(arrays, json.loads(file[HEADER].item())["errors"])


# ---------------------------------------------------------------- comparison


@dataclass(frozen=True)
class Row:
    """How one name compares.

    Attributes:
        name: of the array, or of what ended in an error.
        outcome: ``equal``, ``refused`` (the same error in both), ``off``, ``missing``, ``new`` or
            ``broken`` (an error in both that refuses nothing, so that nothing was compared).
        difference: largest relative one; infinite where there is none to tell.
        note: what else there is to say.
        reason: why it is allowed; empty where it is not.
    """

    name: str
    outcome: str
    difference: float = 0.0
    note: str = ""
    reason: str = ""

    @property
    def kind(self) -> str:
        """Kind of models."""
        return self.name.split("/", 1)[0]

    @property
    def fails(self) -> bool:
        """Whether it must not be."""
        return self.outcome in ("off", "missing", "broken") and not self.reason


class Allowed(NamedTuple):
    """A difference that is known.

    Attributes:
        pattern: of names.
        largest: relative difference; infinite where names may be missing too.
        reason: of it.
    """

    pattern: str
    largest: float
    reason: str

    @classmethod
    def read(cls, path: Path) -> list[Allowed]:
        """Read a file of them.

        Raises:
            click.ClickException: for a line without three parts.
        """
        found = []
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            parts = [part.strip() for part in line.split("|")]
            if not line.strip() or line.startswith("#"):
                continue
            if len(parts) != 3 or not all(parts):
                raise click.ClickException(
                    f"{path}:{number}: pattern | largest difference | reason, not {line!r}"
                )
            found.append(
                cls(parts[0], float("inf") if parts[1] == "missing" else float(parts[1]), parts[2])
            )
        return found

    def allows(self, row: Row) -> bool:
        """Whether it holds of a row."""
        return fnmatchcase(row.name, self.pattern) and row.difference <= self.largest


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference of two arrays over the largest number of the first.

    Infinite where there is none.
    """
    if a.shape != b.shape or a.dtype.kind not in "biuf" or b.dtype.kind not in "biuf":
        return float("inf")
    a, b = a.astype(float), b.astype(float)
    differs = ~((a == b) | (np.isnan(a) & np.isnan(b)))
    if not differs.any():
        return 0.0
    apart = np.abs(a[differs] - b[differs]).max()
    finite = np.abs(a[np.isfinite(a)])
    return (
        float(apart / finite.max())
        if np.isfinite(apart) and finite.max(initial=0.0) > 0
        else float("inf")
    )


def _bits(array: np.ndarray) -> tuple[str, tuple[int, ...], bytes]:
    return array.dtype.str, array.shape, array.tobytes()


def _group(name: str) -> str | None:
    """The group in which an array is known by its content; None of one that is known by its
    name.
    """
    return next((name[: name.index(part) + len(part)] for part in BY_CONTENT if part in name), None)


def _by_content(arrays: dict[str, np.ndarray]) -> dict[str, Counter]:
    groups: dict[str, Counter] = {}
    for name, array in arrays.items():
        group = _group(name)
        if group is not None:
            groups.setdefault(group, Counter())[_bits(array)] += 1
    return groups


def _ended(name: str, errors: dict[str, str]) -> str:
    """The error in which a name ended, or one above it; empty where there is none."""
    parts = name.split("/")
    whole = ["/".join(parts[:count]) for count in range(len(parts), 0, -1)]
    above = [*whole, f"{parts[0]}/make"]
    return next((errors[item] for item in above if item in errors), "")


def compare_arrays(a: Dump, b: Dump) -> Iterable[Row]:
    """Rows of all arrays of two dumps."""
    here, there = _by_content(a.arrays), _by_content(b.arrays)
    for name, array in a.arrays.items():
        group, other = _group(name), b.arrays.get(name)
        if other is not None and _bits(array) == _bits(other):
            yield Row(name, "equal")
        elif group is not None and _bits(array) in there.get(group, ()):
            yield Row(name, "equal", note="under another name")
        elif other is None:
            yield Row(name, "missing", float("inf"), _ended(name, b.errors))
        elif name.endswith(MAY_SHRINK) and other < array:
            yield Row(name, "equal", note=f"{array} to {other}")
        else:
            yield Row(name, "off", difference(array, other), _said(array, other))
    for name, array in b.arrays.items():
        group = _group(name)
        if name not in a.arrays and not (group is not None and _bits(array) in here.get(group, ())):
            yield Row(name, "new", note=_ended(name, a.errors))


def _said(a: np.ndarray, b: np.ndarray) -> str:
    if a.dtype != b.dtype and a.dtype.kind != "U":
        return f"{a.dtype} is {b.dtype}"
    if a.shape != b.shape:
        return f"shape {a.shape} is {b.shape}"
    return f"{a} is {b}" if a.ndim == 0 else ""


def compare_errors(a: Dump, b: Dump) -> Iterable[Row]:
    """Rows of all that ended in an error in the first dump, and of what the second one alone ends
    in.
    """
    for name in a.errors.keys() | b.errors.keys():
        one, two = (item.get(name, "").split(":")[0] for item in (a.errors, b.errors))
        if one and one == two:
            refused = one.startswith(PACKAGES[0])
            yield Row(
                name,
                "refused" if refused else "broken",
                0.0 if refused else float("inf"),
                a.errors[name],
            )
        elif one and two:
            yield Row(name, "off", float("inf"), f"{a.errors[name]}  is  {b.errors[name]}")
        elif one:
            yield Row(name, "new", note=f"was {a.errors[name]}")
        elif not any(key == name or key.startswith(f"{name}/") for key in a.arrays):
            yield Row(name, "new", note=b.errors[name])
        else:
            yield Row(name, "missing", float("inf"), b.errors[name])


def compared(a: Dump, b: Dump, allowed: Sequence[Allowed] = ()) -> list[Row]:
    """All rows of two dumps, with the reasons of those that are allowed."""
    found = [*compare_arrays(a, b), *compare_errors(a, b)]
    reasons = {
        row: next((item.reason for item in allowed if item.allows(row)), "") for row in found
    }
    return [replace(row, reason=reasons[row]) if row.outcome not in ALIKE else row for row in found]


def print_rows(rows: Sequence[Row], every: bool) -> None:
    """Print a table: counts of each kind, and the rows that are not equal."""
    outcomes = ("equal", "refused", "off", "missing", "new", "broken")
    kinds: dict[str, list[Row]] = {}
    for row in rows:
        kinds.setdefault(row.kind, []).append(row)
    width = max([len(kind) for kind in kinds] + [5])
    click.echo(f"{'':{width}}  " + "".join(f"{name:>9}" for name in (*outcomes, "allowed")))
    for kind, own in [*kinds.items(), ("all", list(rows))]:
        counts = [sum(row.outcome == name for row in own) for name in outcomes]
        counts.append(sum(bool(row.reason) for row in own))
        click.echo(f"{kind:{width}}  " + "".join(f"{count or '':>9}" for count in counts))
    for kind, own in kinds.items():
        other = [row for row in own if row.outcome not in ALIKE]
        other.sort(key=lambda row: (not row.fails, row.outcome, -row.difference))
        shown = other if every else other[:SHOWN]
        if shown:
            click.echo(f"\n{kind}")
        for row in shown:
            by = f" by {row.difference:.1e}" if row.outcome == "off" else ""
            why = f"  [allowed: {row.reason}]" if row.reason else ""
            note = f"  {' '.join(row.note.split())[:160]}" if row.note else ""
            click.echo(f"  {row.outcome}{by}  {row.name}{note}{why}")
        if len(other) > len(shown):
            click.echo(f"  and {len(other) - len(shown)} more, shown by --all")


# ---------------------------------------------------------------- commands


@click.group(help=__doc__)
def main() -> None:
    """Take a command."""


@main.command("dump")
@click.argument("out", type=click.Path(dir_okay=False, path_type=Path))
@click.option("--only", default="*", help="pattern of the kinds of models to dump, '*friction*'")
def dump_command(out: Path, only: str) -> None:
    """Record what the first tree on PYTHONPATH gives."""
    tree = tree_on_path()
    load_tree(tree)
    import same_kinds

    record, begun = same_kinds.Record(), time.perf_counter()

    def announce(kind: str) -> None:
        click.echo(f"{time.perf_counter() - begun:6.1f} s  {kind}", err=True)

    same_kinds.dump(record, lambda kind: fnmatchcase(kind, only), announce)
    Dump(record.arrays, record.errors).write(out)
    seconds = f"{time.perf_counter() - begun:.0f} s, {time.process_time():.0f} s of a core"
    click.echo(
        f"{out}: {len(record.arrays)} arrays, {len(record.errors)} refusals and errors in {seconds}"
    )


@main.command("compare")
@click.argument("a", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("b", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "--allow",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="known differences",
)
@click.option("--all", "every", is_flag=True, help="print every row that is not equal")
def compare_command(a: Path, b: Path, allow: Path | None, every: bool) -> None:
    """Print what differs between two dumps; exit 1 if that is not allowed."""
    allowed = [] if allow is None else Allowed.read(allow)
    rows = compared(Dump.read(a), Dump.read(b), allowed)
    print_rows(rows, every)
    idle = [
        item
        for item in allowed
        if not any(row.outcome not in ALIKE and item.allows(row) for row in rows)
    ]
    for item in idle if every else []:
        click.echo(f"nothing differs that is allowed by: {item.pattern} | {item.reason}")
    if idle and not every:
        click.echo(
            f"\n{len(idle)} of {len(allowed)} lines allow nothing that differs here, shown by --all"
        )
    failed = sum(row.fails for row in rows)
    click.echo(f"\n{failed} of {len(rows)} differ and are not allowed" if failed else "\nthe same")
    sys.exit(int(failed > 0))


if __name__ == "__main__":
    main()
