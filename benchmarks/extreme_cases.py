"""Stiff and extreme cases: solved right, or refused with the reason, and never silently wrong.

Each case changes one thing about a small pellet-cladding scene, or is a small scene of its own:
blocks, half-discs, rings, strips and tubes. What is checked against what stands in
``benchmarks/verify.py``. The exit code is 1 if any answer is wrong without a word.

    python benchmarks/extreme_cases.py [--out DIR] [--quick] [--seed N]
"""

import sys

import _demos  # noqa: F401 (before the scenes)
from extreme_contact import contact_cases
from extreme_flow import flow_cases
from extreme_laws import law_cases
from extreme_matching import matching_cases
from extreme_nonmatching import non_matching_cases
from extreme_surfaces import surface_cases
from extreme_tubes import tube_cases
from parts import cli
from verify import as_report, verify

from hhr_dolfinx.plugins.studies import report


def main() -> int:
    """Run all cases, print the table, write ``report.json``, and the rows as printed to
    ``extreme_cases.json``.
    """
    options = cli.parse_on_first_rank(cli.demo_parser("extreme_cases", __doc__))
    counts = (10, 8) if options.quick else (20, 16)
    elastic = [*matching_cases(), *contact_cases(), *non_matching_cases(), *surface_cases()]
    flowing = [*flow_cases(), *tube_cases(), *([] if options.quick else law_cases())]
    rows = [
        row
        for case in options.progress("cases")(elastic)
        for row in verify(case, counts, options.seed)
    ]
    rows += [
        row
        for case in options.progress("flow")(flowing)
        for row in verify(case, counts, options.seed)
    ]
    cli.print_rows("extreme cases", rows, options.console)
    report.write_report(rows, options.out, "extreme_cases")
    report.write_report(as_report(rows, options.seed), options.out)
    wrong = [row["case"] for row in rows if row["outcome"] == "WRONG"]
    options.console.print(f"{len(rows)} rows, silently wrong: {wrong or 'none'}")
    return len(wrong) > 0


if __name__ == "__main__":
    sys.exit(main())
