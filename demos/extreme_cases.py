"""Stiff and extreme cases: solved right, or refused with the reason, and never silently wrong.

Each case changes one thing about a small pellet-cladding scene, or is made of two stacked blocks. What is checked
against what stands in ``hhr_dolfinx/study/verify.py``. The exit code is 1 if any answer is wrong without a word.

    python demos/extreme_cases.py [--out DIR] [--quick] [--seed N]
"""

import sys

from parts.extreme_flow import flow_cases
from parts.extreme_matching import matching_cases
from parts.extreme_nonmatching import non_matching_cases

from hhr_dolfinx.study import cli, report
from hhr_dolfinx.study.verify import verify
from hhr_dolfinx.study.verify_histories import verify_history


def main() -> int:
    """Run all cases, print the table, write ``extreme_cases.json``."""
    options = cli.parse_on_first_rank(cli.demo_parser("extreme_cases", __doc__))
    counts = (10, 8) if options.quick else (20, 16)
    rows = [row for case in options.progress("cases")([*matching_cases(), *non_matching_cases()])
            for row in verify(case, counts, options.seed)]  # fmt: skip
    rows += [row for case in options.progress("flow")(list(flow_cases())) for row in verify_history(case)]
    report.print_rows("extreme cases", rows, options.console)
    report.write_report(rows, options.out, "extreme_cases")
    wrong = [row["case"] for row in rows if row["outcome"] == "WRONG"]
    options.console.print(f"{len(rows)} rows, silently wrong: {wrong or 'none'}")
    return len(wrong) > 0


if __name__ == "__main__":
    sys.exit(main())
