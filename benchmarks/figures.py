"""All figures that README quotes: run the scripts behind them, keep their reports, and write the
table.

Each row is read from the ``report.json`` that a script writes. Figures go into
``docs/figures.json``, and from there into the table between two marks in README. A test compares
both.

    python benchmarks/figures.py [--out DIR] [--quick] [--seed N] [--only NAME ...] [--kept DIR]

All of them take long; ``--only`` measures some again and leaves the others as they are. ``--kept``
reads reports that are there, in a folder for each name, and runs nothing. The script writes into
the checkout that it lies in, but for ``--quick``: figures of small sizes go into ``report.json``
alone.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import _demos  # noqa: F401 (before the parts of demos)

ROOT = Path(__file__).parent.parent
FILE, README = ROOT / "docs" / "figures.json", ROOT / "README.md"
BEGIN, END = (
    "<!-- figures: written by `make figures` from docs/figures.json -->\n",
    "<!-- end of figures -->",
)


class Source(NamedTuple):
    """A scene of the table, the script that measures it, its target of make, and the model that it
    measures.
    """

    title: str
    script: str
    target: str
    model: str


SOURCES = {
    "bolted_joint": Source(
        "bolted joint, Young's modulus varies", "demos/bolted_joint.py", "demo", "condensed"
    ),
    "fretting": Source(
        "fretting of a cylinder, friction", "demos/fretting.py", "fretting", "condensed"
    ),
    "hertz_half_discs": Source(
        "two half-discs", "benchmarks/thesis/hertz_half_discs.py", "hertz", "HHR"
    ),
    "pellet_cladding": Source(
        "fuel pellet and cladding", "benchmarks/thesis/pellet_cladding.py", "pellet", "HHR"
    ),
    "sphere_on_block": Source(
        "sphere on block, in space", "demos/sphere_on_block.py", "sphere", "HHR"
    ),
    "pellet_materials": Source(
        "pellet, E and nu vary", "benchmarks/thesis/pellet_materials.py", "materials", "HHR"
    ),
}


def figures_of(report: dict[str, Any]) -> dict[str, Any]:
    """Figures of one report: sizes, seconds of an answer, ratio, errors of the forces.

    None where it has none.
    """
    times, errors = report["times"], report.get("errors", {}).get("dual_full_floored")
    query = times.get("online", {}).get("median")
    if "friction" in report:
        errors = report["friction"]["errors"]["normal"]
    if "reduction" in report:
        tried = report["reduction"]["tried"][report["reduction"]["chosen"]]
        query, errors = (
            tried["query"],
            {"p95": None, "max": tried["errors"]["forces"], "n": tried["full_answers"]},
        )
    return {
        "N": report["sizes"]["N"],
        "N_lambda": report["sizes"]["N_lambda"],
        "answer_s": query,
        "ratio": report.get("ratios", {}).get("fom_best/online"),
        "p95": errors["p95"],
        "max": errors["max"],
        "n": errors["n"],
        "date": report["date"],
        "machine": report["machine"]["cpu"],
    }


def table(found: dict[str, dict[str, Any]]) -> str:
    """Rows of all scenes that were measured, in Markdown."""
    heads = (
        "scene",
        "unknowns + contacts",
        "model",
        "an answer",
        "speed-up over the best full order",
        "largest force error",
        "command",
    )
    rows = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for name, source in SOURCES.items():
        if name in found:
            row = found[name]
            ratio = "-" if row["ratio"] is None else f"{row['ratio']:.2g}"
            cells = (
                source.title,
                f"{row['N']} + {row['N_lambda']}",
                source.model,
                f"{1e3 * row['answer_s']:.2g} ms",
                ratio,
                f"{row['max']:.1e} ({row['n']} answers)",
                f"`make {source.target}`",
            )
            rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def with_table(text: str, found: dict[str, dict[str, Any]]) -> str:
    """A text with the table between the two marks."""
    before, rest = text.split(BEGIN)
    return before + BEGIN + "\n" + table(found) + "\n" + END + rest.split(END)[1]


def main() -> None:
    """Run, read, write."""
    from parts import cli

    from hhr_dolfinx.plugins.studies import report

    parser = cli.demo_parser("figures", __doc__)
    parser.add_argument(
        "--only", nargs="+", choices=SOURCES, default=list(SOURCES), help="measure these alone"
    )
    parser.add_argument("--kept", type=Path, help="folder of reports that are there: run nothing")
    options = cli.parse_on_first_rank(parser)
    quick = ["--quick"] if options.quick else []
    measured = {}
    for name in options.only:
        folder = (options.kept or options.out) / name
        if options.kept is None:
            script = [sys.executable, str(ROOT / SOURCES[name].script), "--seed", str(options.seed)]
            subprocess.run([*script, *quick, "--out", str(folder)], check=True)
        measured[name] = figures_of(json.loads((folder / "report.json").read_text()))
    written = {"scene": "figures", "seed": options.seed, "figures": measured}
    report.write_report({**written, **report.environment()}, options.out)
    if not options.quick:
        kept = json.loads(FILE.read_text()) | measured
        FILE.write_text(json.dumps(kept, indent=1) + "\n")
        README.write_text(with_table(README.read_text(), kept))
    print(table(measured), end="")


if __name__ == "__main__":
    main()
