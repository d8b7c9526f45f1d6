"""Mutation run: change a rule of the code, run the tests that name its file, and print each change
that no test sees.

    python scripts/mutants.py                     # the decisions below, and 40 random mutants of
    studies and certify python scripts/mutants.py --count 200 --seed 2 python scripts/mutants.py
    --count 10 hhr_dolfinx/plugins/one_call/search.py

Random mutants exchange comparisons, ``and`` and ``or``, ``min`` and ``max``, ``+`` and ``-``,
negate conditions and double numbers. A survivor is a rule that no test holds, or a change without
an effect, which a reader must tell apart: survivors of random mutants are printed, those of the
decisions end the run with exit code 1.

Everything runs in a copy of the repository, one mutant after another, each with a limit of time.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = (
    "hhr_dolfinx/study",
    "hhr_dolfinx/certify",
    "hhr_dolfinx/plugins/studies",
    "hhr_dolfinx/plugins/one_call",
)
MOST_TESTS = 3
"""Test files that are run for one mutant, those with the fewest lines of all that name its file."""
LEFT_OUT = shutil.ignore_patterns(
    ".git", ".venv", "out", "__pycache__", ".mypy_cache", ".pytest_cache", ".ruff_cache"
)
ONE_CALL = "hhr_dolfinx/plugins/one_call"
STUDIES = "hhr_dolfinx/plugins/studies"
DECISIONS = (
    (
        "the worst error counts once",
        f"{ONE_CALL}/search.py",
        "OBSERVED_ERROR_FACTOR = 2.0",
        "OBSERVED_ERROR_FACTOR = 1.0",
    ),
    (
        "no check where the worst is expected",
        f"{ONE_CALL}/search.py",
        "points[worst_first[: FRESH // 2]]",
        "None",
    ),
    (
        "earlier checks are forgotten",
        f"{ONE_CALL}/search.py",
        "before = list(context.held_out)",
        "before: list = []",
    ),
    (
        "the first model that meets is taken",
        f"{ONE_CALL}/search.py",
        (
            "return min(\n        (number for number in met if tried[number].query <= "
            "SIMILAR_TIME * quickest), key=worst\n    )"
        ),
        "return met[0]",
    ),
    (
        "a bound is looked at in 5 points",
        f"{ONE_CALL}/search.py",
        "ERROR_POINTS = 500",
        "ERROR_POINTS = 5",
    ),
    ("checks are not set apart", f"{ONE_CALL}/context.py", "FRESH_SEED = 7000", "FRESH_SEED = 0"),
    (
        "unsettled interpolation is believed",
        f"{ONE_CALL}/search.py",
        "    if off:\n",
        "    if False:\n",
    ),
    (
        "condensation though 300 times slower",
        f"{STUDIES}/advice.py",
        "exact <= 3 * reduced",
        "exact <= 300 * reduced",
    ),
    (
        "speed whatever the error",
        f"{STUDIES}/advice.py",
        'max(rows[method]["dual_full_floored_max"], EQUALLY_ACCURATE),',
        "EQUALLY_ACCURATE,",
    ),
    (
        "95 % and worst exchanged in a row",
        f"{STUDIES}/measure.py",
        'f"{name}_p95": figures["p95"],\n                f"{name}_max": figures["max"],',
        'f"{name}_p95": figures["max"],\n                f"{name}_max": figures["p95"],',
    ),
    (
        "columns of a page exchanged",
        f"{STUDIES}/page.py",
        'figures.get(name)) for name in ("median", "p95", "max")),',
        'figures.get(name)) for name in ("median", "max", "p95")),',
    ),
    (
        "break-even forgets the reduced time",
        f"{STUDIES}/report.py",
        'saved = times["fom_best"]["median"] - times[kind]["median"]',
        'saved = times["fom_best"]["median"]',
    ),
    (
        "answers of files cost nothing",
        f"{STUDIES}/report.py",
        'return {FROM_FILES: training.read / steps * fom_best["median"]}',
        "return {FROM_FILES: 0.0}",
    ),
)
"""Rules that decide which model a user gets, or what he reads of it: each of these changes must
fail a test.
"""

COMPARED = {
    ast.Lt: ast.Gt,
    ast.LtE: ast.GtE,
    ast.Gt: ast.Lt,
    ast.GtE: ast.LtE,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
COUNTED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
NAMED = {
    "min": "max",
    "max": "min",
    "any": "all",
    "all": "any",
    "argmin": "argmax",
    "argmax": "argmin",
}


@dataclass(frozen=True)
class Mutant:
    """A changed file.

    Attributes:
        name: what was changed, for a reader.
        path: of the file, below the root.
        text: of the changed file.
    """

    name: str
    path: str
    text: str


def changed(node: ast.AST) -> bool:
    """Change a node in place; whether there is a way to."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARED:
        node.ops = [COMPARED[type(node.ops[0])](), *node.ops[1:]]
    elif isinstance(node, ast.BoolOp):
        node.op = ast.And() if isinstance(node.op, ast.Or) else ast.Or()
    elif isinstance(node, ast.BinOp) and type(node.op) in COUNTED and not _is_text(node):
        node.op = COUNTED[type(node.op)]()
    elif isinstance(node, ast.Name) and node.id in NAMED:
        node.id = NAMED[node.id]
    elif isinstance(node, ast.Attribute) and node.attr in NAMED:
        node.attr = NAMED[node.attr]
    elif isinstance(node, ast.If | ast.IfExp):
        node.test = ast.UnaryOp(ast.Not(), node.test)
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value:
        node.value = 2 * node.value
    else:
        return False
    return True


def _is_text(node: ast.BinOp) -> bool:
    """Whether a sum is one of texts, whose wording tests of rules do not read."""
    return any(
        isinstance(part, ast.JoinedStr) or isinstance(getattr(part, "value", None), str)
        for part in ast.walk(node)
    )


def places_of(path: str) -> list[int]:
    """Numbers of the nodes of a file that can be changed."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    return [number for number, node in enumerate(ast.walk(tree)) if changed(copy.copy(node))]


def mutant_at(path: str, place: int) -> Mutant:
    """A file with one node changed."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    lines = ast.unparse(tree).splitlines()
    node = next(item for number, item in enumerate(ast.walk(tree)) if number == place)
    changed(node)
    text = ast.unparse(ast.fix_missing_locations(tree))
    both = next(pair for pair in zip(lines, text.splitlines(), strict=False) if pair[0] != pair[1])
    before, after = (" ".join(line.split()) for line in both)
    return Mutant(f"{path}:{getattr(node, 'lineno', 0)}: {before}  ->  {after}", path, text)


def decisions() -> Iterator[Mutant]:
    """The changes that must be seen."""
    for name, path, before, after in DECISIONS:
        text = (ROOT / path).read_text(encoding="utf-8")
        if text.count(before) != 1:
            raise SystemExit(
                f"{path} has {text.count(before)} places of {before!r} for '{name}': mend DECISIONS"
            )
        yield Mutant(f"{path}: {name}", path, text.replace(before, after))


def tests_of(path: str) -> list[str]:
    """Test files that import a file of the package, the shortest first."""
    module = Path(path).with_suffix("")
    dotted, package = re.escape(".".join(module.parts)), re.escape(".".join(module.parent.parts))
    named = re.compile(rf"\b{dotted}\b|from {package} import [^#\n]*\b{module.name}\b")
    found = [
        file
        for file in (ROOT / "tests").rglob("test_*.py")
        if named.search(file.read_text(encoding="utf-8"))
    ]
    found.sort(key=lambda file: file.stat().st_size)
    return [str(file.relative_to(ROOT)) for file in found]


def is_seen(mutant: Mutant, place: Path, tests: Sequence[str], seconds: float) -> bool:
    """Whether a test fails, or does not end, with a mutant in the place of its file."""
    target = place / mutant.path
    before = target.read_text(encoding="utf-8")
    target.write_text(mutant.text, encoding="utf-8")
    words = [
        sys.executable,
        "-m",
        "pytest",
        "-n",
        "0",
        "-q",
        "-x",
        "-p",
        "no:cacheprovider",
        *tests,
    ]
    paths = [str(place), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(paths),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    try:
        found = subprocess.run(
            words, cwd=place, env=environment, capture_output=True, timeout=seconds, check=False
        )
        return found.returncode != 0
    except subprocess.TimeoutExpired:
        return True
    finally:
        target.write_text(before, encoding="utf-8")


def drawn(given: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """Random mutants of files; those that no test names are printed and left out."""
    paths = given or [
        str(file.relative_to(ROOT))
        for folder in FOLDERS
        for file in sorted((ROOT / folder).rglob("*.py"))
    ]
    every = [(path, place) for path in paths if tests_of(path) for place in places_of(path)]
    for path in paths:
        if not tests_of(path) and not path.endswith("__init__.py"):
            print(f"no test names {path}", flush=True)
    return [mutant_at(*one) for one in random.Random(seed).sample(every, min(count, len(every)))]


def main() -> int:
    """Run the mutants, and print what survives."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "paths", nargs="*", help="files to change; those of studies and certify by default"
    )
    parser.add_argument("--count", type=int, default=40, help="random mutants")
    parser.add_argument("--seed", type=int, default=1, help="of the random mutants")
    parser.add_argument(
        "--seconds",
        type=float,
        default=900.0,
        help="after which the tests of a mutant count as failed",
    )
    given = parser.parse_args()
    must = [] if given.paths else list(decisions())
    may = drawn(given.paths, given.count, given.seed)
    survivors: list[Mutant] = []
    with tempfile.TemporaryDirectory(prefix="mutants_") as folder:
        place = Path(folder) / "copy"
        shutil.copytree(ROOT, place, ignore=LEFT_OUT, symlinks=True)
        for number, mutant in enumerate([*must, *may], 1):
            seen = is_seen(mutant, place, tests_of(mutant.path)[:MOST_TESTS], given.seconds)
            survivors += [] if seen else [mutant]
            print(
                (
                    f"{number} of {len(must) + len(may)}, {'seen' if seen else 'SURVIVES'}: "
                    f"{mutant.name}"
                ),
                flush=True,
            )
    print(f"\n{len(survivors)} of {len(must) + len(may)} survive:")
    print("\n".join(mutant.name for mutant in survivors))
    return int(any(mutant in must for mutant in survivors))


if __name__ == "__main__":
    sys.exit(main())
