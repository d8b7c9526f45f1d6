"""Make the pictures of the documentation anew, all of them or some by name, and say which are
stale.

    python scripts/pictures.py                 # all: ``make pictures``
    python scripts/pictures.py flange fretting # some: ``make pictures ONLY="flange fretting"``
    python scripts/pictures.py --list          # names, commands, and what is stale

``docs/pictures/sources.json`` keeps for each picture the command that makes it, a digest of each of
its sources and one of the file. A digest of Python is that of its syntax tree without docstrings:
comments, words and the layout of lines leave it as it is. A picture is stale once a digest differs.
"""

import argparse
import ast
import hashlib
import json
import shutil
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
TABLE = DOCS / "pictures" / "sources.json"
OUT = ROOT / "out" / "pictures"

PLOTS = "hhr_dolfinx/plugins/plots"
PLANE = f"{PLOTS}/figures.py", f"{PLOTS}/picture.py"
SPACE = f"{PLOTS}/figures_in_space.py", f"{PLOTS}/picture.py"
CURVES = ("hhr_dolfinx/plugins/studies/plots.py::plot_curves",)
FRICTION = ("demos/parts/friction_picture.py::draw_friction",)
PAGE = tuple(
    f"hhr_dolfinx/plugins/pages/{name}"
    for name in ("page.html", "page.css", "view.js", "plots.js", "field.js", "drawing.js")
)
REPORT = (
    "hhr_dolfinx/plugins/studies/page.py",
    "hhr_dolfinx/plugins/studies/charts.py",
    "hhr_dolfinx/plugins/studies/report.css",
)
PELLET = "benchmarks/thesis/pellet_cladding.py"
PELLET_MESH = "geometries/pellet_cladding.py"
SPHERE_MESH = "geometries/sphere_on_block.py"


class Picture(NamedTuple):
    """How a picture is made.

    Attributes:
        way: name of a function of ``picture_makers.py``, and its arguments.
        sources: files whose digests tell whether it is stale; ``file.py::name`` is one function.
    """

    way: tuple[str, ...]
    sources: tuple[str, ...]

    @property
    def command(self) -> str:
        """What makes it, in words of a shell."""
        name, *words = self.way
        if name == "of_run":
            script, file, *options = words
            return " ".join(["python", script, *options, f"-> {file}"])
        return f"scripts/picture_makers.py: {name}({', '.join(words)})"


def _own(name: str) -> str:
    """The function of ``picture_makers.py`` that makes one picture alone."""
    return f"scripts/picture_makers.py::{name}"


def _answer(script: str, *others: str) -> Picture:
    """A picture of an answer on the scene of a script, at a point that its table names."""
    return Picture(("of_answer", Path(script).stem), (script, *others))


def _run(script: str, file: str, *others: str, options: tuple[str, ...] = ()) -> Picture:
    """A picture that a script itself writes."""
    return Picture(("of_run", script, file, *options), (script, *others))


def _thesis(chapter: int, figure: str) -> Picture:
    """A picture of a chapter of the thesis, which takes some minutes."""
    folder = "benchmarks/thesis"
    return _run(
        f"{folder}/side_by_side.py",
        f"{figure}.png",
        f"{folder}/chapter_{chapter}.py",
        f"{folder}/items.py",
        options=("--chapter", str(chapter)),
    )


LEAF_SPRING = "demos/meshes/leaf_spring.py"
FLANGE = "demos/parts/flange_solids.py"
PICTURES = {
    "pictures/bolt_preload.png": _run("demos/bolt_preload.py", "preload.png", *CURVES),
    "pictures/bolted_joint.png": _run("demos/bolted_joint.py", "answer.png", *PLANE),
    "pictures/flange.png": _run("demos/flange.py", "flange.png", FLANGE, *CURVES),
    "pictures/flange_part.png": _run("demos/flange.py", "flange_part.png", FLANGE, *SPACE),
    "pictures/fretting.png": _run(
        "demos/fretting.py", "fretting.png", "demos/parts/fretting_study.py", *FRICTION
    ),
    "pictures/fuel_rod.png": _answer("demos/fuel_rod.py", PELLET_MESH, *PLANE),
    "pictures/held_by_contact.png": _answer(
        "demos/held_by_contact.py", "demos/parts/o_ring.py", *PLANE
    ),
    "pictures/hertz_half_discs.png": _answer(
        "benchmarks/thesis/hertz_half_discs.py", "geometries/hertz_half_discs.py", *PLANE
    ),
    "pictures/pellet_cladding.png": _answer(PELLET, PELLET_MESH, *PLANE),
    "pictures/pellet_cladding_nonmatching.png": _answer(
        "benchmarks/thesis/pellet_cladding_nonmatching.py", PELLET, PELLET_MESH, *PLANE
    ),
    "pictures/pellet_cladding_plastic.png": Picture(
        ("of_plastic_pellet",),
        (
            "benchmarks/thesis/pellet_cladding_plastic.py",
            PELLET_MESH,
            *PLANE,
            _own("of_plastic_pellet"),
        ),
    ),
    "pictures/pellet_materials.png": _answer(
        "benchmarks/thesis/pellet_materials.py", PELLET, PELLET_MESH, *PLANE
    ),
    "pictures/press_fit.png": _answer("demos/press_fit.py", "geometries/press_fit.py", *SPACE),
    "pictures/press_fit_torque.png": _run(
        "demos/press_fit_torque.py",
        "press_fit_torque.png",
        "demos/parts/press_fit_torque_study.py",
        options=("--quick", "--designs", "1", "--cases", "300"),  # a quarter of an hour otherwise
    ),
    "pictures/sliding_punch.png": _run(
        "demos/sliding_punch.py", "sliding_punch.png", "demos/parts/sliding_punch_study.py"
    ),
    "pictures/sphere_on_block.png": _answer("demos/sphere_on_block.py", SPHERE_MESH, *SPACE),
    "pictures/thesis_figure_1_9.png": _thesis(1, "figure_1_9"),
    "pictures/thesis_figure_2_12.png": _thesis(2, "figure_2_12"),
    "pictures/thesis_figure_3_1_and_3_5.png": _thesis(3, "figure_3_1_and_3_5"),
    "pictures/thesis_figure_3_9_and_3_10.png": _thesis(3, "figure_3_9_and_3_10"),
    "pictures/thesis_figure_4_5_and_4_6.png": _thesis(4, "figure_4_5_and_4_6"),
    "pictures/thesis_figure_5_13.png": _thesis(5, "figure_5_13"),
    "pictures/your_scene.png": _answer("demos/your_scene.py", LEAF_SPRING, *PLANE),
    "page.png": Picture(("of_pellet_page",), (PELLET, *PAGE, _own("of_pellet_page"))),
    "page_flow.png": Picture(
        ("of_flow_page",), ("demos/indentation.py", *PAGE, _own("of_flow_page"))
    ),
    "page_friction.png": Picture(
        ("of_friction_page",), ("demos/fretting.py", *PAGE, _own("of_friction_page"))
    ),
    "page_stress.png": Picture(
        ("of_stress_page",), ("demos/sphere_on_block.py", *PAGE, _own("of_stress_page"))
    ),
    "pellet.png": Picture(("of_reduced_pellet",), (PELLET, PELLET_MESH, _own("of_reduced_pellet"))),
    "report.png": Picture(("of_report",), ("demos/press_fit.py", *REPORT, _own("of_report"))),
}
"""All pictures under ``docs/`` by their files."""


def _plain(node: object) -> object:
    """A syntax tree as nested tuples, without places, docstrings, and fields that are empty.

    Not ``ast.dump``, whose words differ from one release of Python to the next.
    """
    if isinstance(node, list):
        return tuple(_plain(item) for item in node)
    if not isinstance(node, ast.AST):
        return repr(node)
    fields = dict(ast.iter_fields(node))
    body = fields.get("body")
    if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and body:
        fields["body"] = [item for item in body if not _is_text(item)]
    kept = {
        name: value
        for name, value in fields.items()
        if value not in (None, []) and name not in ("ctx", "kind", "type_comment")
    }
    return (type(node).__name__, *((name, _plain(value)) for name, value in kept.items()))


def _is_text(node: ast.AST) -> bool:
    """Whether a statement is a text alone: a docstring, also one below an assignment."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def digest(source: str, root: Path = ROOT) -> str:
    """Digest of a source, 16 hexadecimal digits; ``missing`` without it.

    Args:
        source: file below the root, or ``file.py::name`` for one function of it.
        root: folder of the checkout.
    """
    file, _, name = source.partition("::")
    path = root / file
    if not path.exists():
        return "missing"
    text = path.read_text()
    if path.suffix != ".py":
        return hashlib.sha256(" ".join(text.split()).encode()).hexdigest()[:16]
    module = ast.parse(text)
    tree: ast.AST = module
    if name:
        named = (ast.FunctionDef, ast.ClassDef)
        found = [node for node in module.body if isinstance(node, named) and node.name == name]
        if not found:
            return "missing"
        (tree,) = found
    return hashlib.sha256(repr(_plain(tree)).encode()).hexdigest()[:16]


def digest_of_file(path: Path) -> str:
    """Digest of the bytes of a picture, 16 hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def stale(table: dict[str, dict], docs: Path = DOCS, root: Path = ROOT) -> dict[str, str]:
    """Why pictures are stale, by their files; those that are not are left out.

    Args:
        table: what ``sources.json`` keeps.
        docs: folder of the pictures.
        root: folder of the sources.
    """
    reasons = {}
    for file, picture in PICTURES.items():
        remedy = f'run: make pictures ONLY="{Path(file).stem}"'
        row = table.get(file)
        if row is None or not (docs / file).exists():
            reasons[file] = f"docs/{file} was never made; {remedy}"
            continue
        digests = {source: digest(source, root) for source in picture.sources}
        changed = [source for source in digests if digests[source] != row["sources"].get(source)]
        if changed:
            verb = "has" if len(changed) == 1 else "have"
            reasons[file] = (
                f"docs/{file} is stale: {', '.join(changed)} {verb} changed since it was made; "
                f"{remedy}"
            )
        elif digest_of_file(docs / file) != row["picture"]:
            reasons[file] = f"docs/{file} is not the picture that its command made; {remedy}"
    return reasons


def read_table() -> dict[str, dict]:
    """What ``sources.json`` keeps, by file; empty without it."""
    return json.loads(TABLE.read_text()) if TABLE.exists() else {}


def write_row(file: str, digests: dict[str, str]) -> None:
    """Keep command and digests of a picture that has just been made.

    Args:
        file: of the picture, below ``docs/``.
        digests: of its sources, by file, as they were when this program began.
    """
    picture = PICTURES[file]
    table = read_table()
    table[file] = {
        "command": picture.command,
        "sources": digests,
        "picture": digest_of_file(DOCS / file),
    }
    TABLE.write_text(json.dumps(dict(sorted(table.items())), indent=1) + "\n")


def make(file: str, digests: dict[str, str]) -> None:
    """Make one picture, and keep its row.

    Args:
        file: of the picture, below ``docs/``.
        digests: of its sources, by file.

    Raises:
        MissingProgramError: of ``picture_makers.py``, without a browser for a page.
    """
    sys.path[:0] = [str(ROOT / name) for name in ("scripts", "demos", "benchmarks/thesis")]
    import picture_makers

    name, *words = PICTURES[file].way
    maker: Callable[[], Path] = partial(getattr(picture_makers, name), *words)
    made = maker()
    (DOCS / file).parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(made, DOCS / file)
    write_row(file, digests)


def listed() -> str:
    """A line for each picture: its file, its command, and whether it is stale."""
    reasons = stale(read_table())
    return "\n".join(
        f"{'stale ' if file in reasons else '      '}{file:<42} {picture.command}"
        for file, picture in PICTURES.items()
    )


def main() -> int:
    """Make what was asked for; 1 if some could not be made."""
    stems = {Path(file).stem: file for file in PICTURES}
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"of {', '.join(stems)}; all without any"
    )
    parser.add_argument("--stale", action="store_true", help="those alone that are stale")
    parser.add_argument("--list", action="store_true", help="make nothing, list them")
    options = parser.parse_args()
    unknown = sorted(set(options.names) - set(stems))
    if unknown:
        parser.error(f"there is no picture {', '.join(unknown)}: choose of {', '.join(stems)}")
    if options.list:
        print(listed())
        return 0
    files = [stems[name] for name in options.names] or list(PICTURES)
    if options.stale:
        reasons = stale(read_table())
        files = [file for file in files if file in reasons]
    # before anything is imported: what is edited in the meantime makes no picture
    digests = {file: {name: digest(name) for name in PICTURES[file].sources} for file in files}
    failed = []
    for file in files:
        began = time.perf_counter()
        print(f"docs/{file}: {PICTURES[file].command}", flush=True)
        try:
            make(file, digests[file])
        except Exception as error:  # the others are made all the same
            failed.append(file)
            print(f"    not made: {error}", flush=True)
        else:
            print(f"    made in {time.perf_counter() - began:.0f} s", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
