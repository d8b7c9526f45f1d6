"""Composition: each capability of the plug-ins, alone, in pairs and in triples, in each verb.

    python benchmarks/compose.py [--out DIR] [--quick] [--seed N] [--pairs] [--triples N]
        [--only NAME,NAME] [--one NAME,NAME] [--verbs VERB,VERB] [--workers N] [--limit SECONDS]
        [--again] [--docs [PAGE]]

Capabilities are the switches of the manifests (`Plugin.switches`), each added to a small scene of
two blocks whose contact opens and closes along a load path. Each composition runs in a process of
its own. `report.json` has a row for each composition and verb, `compose[{capabilities, verb,
outcome, reason, neutral}]`, and the share that works; what is in it is not run again. `--docs`
writes the page of the report. One composition alone, with what it says:

    python benchmarks/compose.py --one voce,friction --verbs full,page
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import random
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import _demos  # noqa: F401 (before the parts of demos)
import compose_table
import compose_toys
import compose_verbs
from compose_verbs import VERBS, Row
from parts import cli

from hhr_dolfinx.plugins.conformance.draft import switches
from hhr_dolfinx.plugins.studies import report

QUICK = (("friction", "young"), ("opening", "thermal"), ("axisymmetric", "solid"))
"""Compositions of a first look."""
KEPT_EVERY = 5
"""Compositions after which the report is written."""
Names = tuple[str, ...]


def capabilities() -> list[str]:
    """Names of all switches, of the templates and toys too."""
    with compose_toys.registered():
        return sorted(switches())


def compositions(options: argparse.Namespace, names: list[str]) -> list[Names]:
    """Compositions to run: the empty one, singles, pairs and triples, in their order."""
    if options.quick:
        return [(), *QUICK]
    only, one = (words(text, names, "capabilities") for text in (options.only, options.one))
    if one:
        return [tuple(sorted(one))]
    found: list[Names] = [(), *((name,) for name in names)]
    draw = random.Random(options.seed)
    pairs, triples = (list(itertools.combinations(names, count)) for count in (2, 3))
    if options.pairs:  # in a random order: shares of a run that was ended are those of a sample
        found += draw.sample(pairs, len(pairs))
    found += draw.sample(triples, min(options.triples, len(triples)))
    return [one for one in found if not only or set(one) & set(only)]


def words(text: str, known: Iterable[str], what: str) -> Names:
    """Words apart by commas.

    Raises:
        SystemExit: for a word that is not known.
    """
    found = tuple(word.strip() for word in text.split(",") if word.strip())
    if unknown := sorted(set(found) - set(known)):
        raise SystemExit(f"{', '.join(unknown)}: {what} are {', '.join(known)}")
    return found


def run(names: Names, verbs: Names, limit: float) -> list[Row]:
    """Rows of a composition from a process of its own, which is ended after some seconds."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["compose_loaded"])
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=compose_verbs.in_a_child, args=(theirs, names, verbs))
    child.start()
    theirs.close()
    rows: list[Row] = []
    try:
        while len(rows) < len(verbs) and ours.poll(limit):
            rows.append(ours.recv())
        ended = "time out"
    except EOFError:
        ended = "crash"
    if len(rows) == len(verbs):
        child.join(limit)
    child.kill()
    child.join()
    if len(rows) < len(verbs):
        lost = verbs[len(rows) :]
        code = f"the process ended with {child.exitcode}"
        why = f"over {limit:g} s" if ended == "time out" else code
        rows.append(Row(names, lost[0], ended, why))
        rows += [Row(names, verb, ended, f"after {lost[0]}: {why}") for verb in lost[1:]]
    return rows


def known_rows(file: Path) -> dict[tuple[Names, str], dict[str, Any]]:
    """Rows of a report, by composition and verb; none without the file."""
    if not file.exists():
        return {}
    rows = json.loads(file.read_text(encoding="utf-8")).get("compose", [])
    return {(tuple(row["capabilities"]), row["verb"]): row for row in rows}


def as_dict(row: Row) -> dict[str, Any]:
    """The row as the report has it."""
    return {**row._asdict(), "capabilities": list(row.capabilities)}


def write(rows: Iterable[dict[str, Any]], names: list[str], options: argparse.Namespace) -> None:
    """Write the report."""
    every = list(rows)
    made = {"scene": "compose", "seed": options.seed, "capabilities": names, "compose": every}
    made |= {"shares": compose_table.shares(every), **report.environment()}
    report.write_report(made, options.out)


def results(to_do: list[tuple[Names, Names]], options: argparse.Namespace) -> Iterator[list[Row]]:
    """Rows of compositions as they end, with a progress bar."""
    shown = cli.progress_on(options.console)("compositions")
    with ThreadPoolExecutor(max_workers=options.workers) as pool:
        jobs = [pool.submit(run, names, verbs, options.limit) for names, verbs in to_do]
        for job in shown(Sized(as_completed(jobs), len(jobs))):
            yield job.result()


class Sized:
    """Iterations whose number is known."""

    def __init__(self, items: Iterator[Any], count: int):
        self.items = items
        self.count = count

    def __iter__(self) -> Iterator[Any]:
        return self.items

    def __len__(self) -> int:
        return self.count


def parsed() -> argparse.Namespace:
    """Options of the command line."""
    parser = cli.demo_parser("compose", __doc__)
    add = parser.add_argument
    add("--pairs", action="store_true", help="all pairs too")
    add("--triples", type=int, default=0, metavar="N", help="so many random triples too [0]")
    add("--only", default="", help="capabilities of which each composition has one [all]")
    add("--one", default="", help="capabilities of one composition, which is run again")
    add("--verbs", default=",".join(VERBS), help="verbs, apart by commas [%(default)s]")
    add("--workers", type=int, choices=(1, 2), default=1, help="processes at once [1]")
    add("--limit", type=float, default=120.0, help="seconds of one verb [120]")
    add("--again", action="store_true", help="run what is in the report again")
    page = compose_table.PAGE
    add("--docs", type=Path, nargs="?", const=page, help="write the page, and run nothing")
    return cli.parse_on_first_rank(parser)


def main() -> None:
    """Run what the report has not, print a table, write the report."""
    options = parsed()
    verbs = words(options.verbs, VERBS, "verbs")
    known = {} if options.again else known_rows(options.out / "report.json")
    names = capabilities()
    if options.docs is not None:
        options.docs.write_text(compose_table.page(list(known.values()), names), encoding="utf-8")
        return
    options.out.mkdir(parents=True, exist_ok=True)
    to_do = []
    for one in compositions(options, names):
        rest = tuple(verb for verb in verbs if options.one or (one, verb) not in known)
        to_do += [(one, rest)] if rest else []
    for count, rows in enumerate(results(to_do, options), start=1):
        known |= {(row.capabilities, row.verb): as_dict(row) for row in rows}
        for row in rows:
            if options.one or row.outcome in compose_table.FAULTS:
                said = " + ".join(row.capabilities), row.verb, row.outcome, row.reason
                options.console.print(*said, markup=False)
        if count % KEPT_EVERY == 0:
            write(known.values(), names, options)
    write(known.values(), names, options)
    for line in compose_table.share_lines(list(known.values())):
        options.console.print(line, markup=False, highlight=False)


if __name__ == "__main__":
    main()
