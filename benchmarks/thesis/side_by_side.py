"""The thesis and this code side by side: each figure and table of its chapters 1 to 6.

    python benchmarks/thesis/side_by_side.py [--out DIR] [--quick] [--seed N] [--chapter N]
        [--docs [PAGE]]

Scenes are trained and models built as the thesis says, by the recipe that it names, and by ours;
the same figures are read off both. `report.json` has them under `thesis{item: {printed,
as_printed, ours, reason, command}}`; `--docs` writes the page of the report and its pictures. A
chapter that was run before is kept in the report until it is run again.

What to see: where the thesis names all steps its figures come back. Where DEIM picks other nodes,
since the mesh is another one, sizes differ by some functions and errors by some factor. The usual
recipe is more exact by one to three orders on the same answers.
"""

from __future__ import annotations

import importlib
import json
import shutil
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
CHAPTERS = 1, 2, 3, 4, 5, 6
PAGE = ROOT / "docs" / "thesis.md"
PICTURES = {
    "figure_1_9": "Figure 1.9 on the pellet: relative errors of bases of displacements and forces",
    "figure_2_12": "Figure 2.12: greedy choices by eta and by eta_2",
    "figure_3_1_and_3_5": "Figures 3.1 and 3.5: errors beside the condition number of contact rows",
    "figure_3_9_and_3_10": "Figures 3.9 (above) and 3.10 (below): errors of forces",
    "figure_4_5_and_4_6": "Figures 4.5 (above) and 4.6 (below): local models",
    "figure_5_13": "Figure 5.13 (above): meshes that do not match",
}
"""Pictures of the page, and what they show."""


def main() -> None:
    """Run chapters, print their items, write the report, and the page if asked."""
    sys.path += [str(ROOT / "demos"), str(ROOT / "benchmarks")]
    from items import Cases
    from parts import cli

    from hhr_dolfinx.plugins.studies import report
    from hhr_dolfinx.warn import ignored

    parser = cli.demo_parser("thesis", __doc__)
    parser.add_argument(
        "--chapter", type=int, choices=CHAPTERS, action="append", help="chapters to run [all]"
    )
    parser.add_argument(
        "--docs", type=Path, nargs="?", const=PAGE, help="write the page of the report [docs]"
    )
    options = cli.parse_on_first_rank(parser)
    cases = Cases(options.out, options.quick, options.progress, options.seed)
    known = _known(options.out)
    for chapter in options.chapter or CHAPTERS:
        with ignored(Warning):  # models as printed warn of what their rows say
            rows = [item.row() for item in _items(chapter, cases)]
        known = [row for row in known if row["chapter"] != chapter]
        known += [{"chapter": chapter, **row} for row in rows]
        for row in rows:
            options.console.print(_line(row), highlight=False, markup=False)
        known.sort(key=lambda row: row["chapter"])
        found = {f"{row['number']}, {row['what']}": row for row in known}
        report.write_report({"thesis": found, **report.environment()}, options.out)
    if options.docs:
        _write_page(known, options.docs, options.out)


def _items(chapter: int, cases: Any) -> Any:
    """Items of a chapter."""
    return importlib.import_module(f"chapter_{chapter}").items(cases)


def _known(folder: Path) -> list[dict[str, Any]]:
    """Rows of an earlier run; none without one."""
    file = folder / "report.json"
    if not file.exists():
        return []
    return list(json.loads(file.read_text(encoding="utf-8")).get("thesis", {}).values())


def _line(row: dict[str, str]) -> str:
    """An item in a line of text."""
    parts = [f"{key}: {row[name]}" for name, key in COLUMNS.items() if row[name]]
    return f"{row['number']}, {row['what']}\n    " + "\n    ".join(parts)


COLUMNS = {
    "printed": "printed",
    "as_printed": "as printed, here",
    "ours": "by default",
    "reason": "why they differ",
}
INTRODUCTION = """# The thesis, side by side

Each figure and table of chapters 1 to 6 of S. Le Berre's thesis (2023) beside what this code finds:
by the steps that the thesis names, and by default. `make thesis` runs all of it in half an hour on
an idle core and writes this page; `--chapter 3` runs one. Equations and algorithms are in
[fidelity](fidelity.md).

Of pictures without numbers the page has what the text of the thesis says. *N_C* is the number of
contact conditions in the RID, *ell* and *ell_bar* are the numbers of modes before and after
enrichment. Errors of a map are over points with P1 >= 40 MPa, where contact does not graze. Times
are of one thread, in turns.
"""


def _write_page(rows: list[dict[str, Any]], page: Path, folder: Path) -> None:
    """Write the page of all rows, and copy its pictures beside it."""
    lines = [INTRODUCTION]
    for chapter in dict.fromkeys(row["chapter"] for row in rows):
        of_chapter = [row for row in rows if row["chapter"] == chapter]
        commands = dict.fromkeys(row["command"] for row in of_chapter if row["command"])
        more = ", ".join(f"`{command}`" for command in commands)
        lines += [f"## Chapter {chapter}", "", f"More of it: {more}.", ""]
        lines += [f"| item | {' | '.join(COLUMNS.values())} |", "|" + "---|" * (len(COLUMNS) + 1)]
        for row in of_chapter:
            cells = [f"**{row['number']}** {row['what']}", *(row[name] for name in COLUMNS)]
            lines.append("| " + " | ".join(cells) + " |")
        lines.append("")
        for name, caption in PICTURES.items():
            if name.startswith(f"figure_{chapter}_") and (folder / f"{name}.png").exists():
                target = page.parent / "pictures" / f"thesis_{name}.png"
                target.parent.mkdir(exist_ok=True)
                shutil.copyfile(folder / f"{name}.png", target)
                lines += [f"![{caption}](pictures/{target.name})", "", f"*{caption}*", ""]
    page.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
