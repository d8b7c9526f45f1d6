"""Tables of the benchmark of composition: shares, the matrix of pairs, sentences of refusals."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from compose_reasons import reason

PAGE = Path(__file__).parents[1] / "docs" / "composition.md"
FAULTS = ("wrong", "crash", "time out")
"""Outcomes that are faults of the package."""
COLUMNS = ("full", "condense", "HHR", "page", "C", "gradient")
"""Verbs of the matrix, in the order in which one needs the other."""
LETTERS = {"full": "F", "condense": "K", "HHR": "H", "page": "P", "C": "P", "gradient": "G"}
SIZES = {0: "none", 1: "singles", 2: "pairs", 3: "triples"}
Rows = list[dict[str, Any]]


def shares(rows: Iterable[dict[str, Any]]) -> dict[str, dict[str, dict[str, int]]]:
    """Numbers of outcomes by verb and by the number of capabilities."""
    found: dict[str, dict[str, Counter[str]]] = defaultdict(lambda: defaultdict(Counter))
    for row in rows:
        size = SIZES.get(len(row["capabilities"]), "more")
        found[row["verb"]][size][row["outcome"]] += 1
    plain_counts: dict[str, dict[str, dict[str, int]]] = {}
    for verb, own in found.items():
        plain_counts[verb] = {size: dict(sorted(count.items())) for size, count in own.items()}
    return plain_counts


def share(counts: dict[str, int]) -> str:
    """Share of what works, without what is excluded and what has nothing to compare, ``none``."""
    left_out = counts.get("excluded", 0) + counts.get("none", 0)
    count = sum(counts.values()) - left_out
    works = counts.get("works", 0)
    return f"{works} of {count} ({100 * works / count:.1f} %)" if count else ""


def share_lines(rows: Rows) -> list[str]:
    """Table of shares, in Markdown."""
    sizes = [size for size in SIZES.values() if size != "none"]
    lines = ["| verb works | " + " | ".join(sizes) + " | refused | wrong, crash, time out |"]
    lines.append("|---|" + "---|" * (len(sizes) + 2))
    for verb, own in shares(rows).items():
        every: Counter[str] = sum((Counter(one) for one in own.values()), Counter())
        cells = [share(own.get(size, {})) for size in sizes]
        faults = sum(every[name] for name in FAULTS)
        lines.append("| " + " | ".join([verb, *cells, str(every["refused"]), str(faults)]) + " |")
    return lines


def letter(outcomes: dict[str, str]) -> str:
    """The first verb that refuses a composition, ``!`` for a fault, ``+`` if all answer."""
    if set(outcomes.values()) & set(FAULTS):
        return "!"
    if "excluded" in outcomes.values():
        return "x"
    for verb in COLUMNS:
        if outcomes.get(verb) == "refused":
            return LETTERS[verb]
    return "+" if outcomes else " "


def matrix(rows: Rows, names: list[str]) -> list[str]:
    """Lines of the matrix of pairs, with singles on the diagonal; columns are numbered as rows."""
    outcomes: dict[frozenset[str], dict[str, str]] = defaultdict(dict)
    for row in rows:
        outcomes[frozenset(row["capabilities"])][row["verb"]] = row["outcome"]
    width = max(map(len, names))
    digits = zip(*(f"{k:02d}" for k in range(1, len(names) + 1)), strict=True)
    heads = [" " * (width + 4) + " ".join(row) for row in digits]
    lines = []
    for k, name in enumerate(names):
        cells = [letter(outcomes.get(frozenset((name, other)), {})) for other in names]
        lines.append(f"{k + 1:2d} {name:{width}} " + " ".join(cells))
    return [line.rstrip() for line in (*heads, *lines)]


def plain(sentence: str) -> str:
    """A sentence without names, numbers and lists, which differ from scene to scene."""
    text = re.sub(r"'[^']*'|\"[^\"]*\"|<[^>]*>|\([^()]*\)", "...", sentence.replace("\n", " "))
    return re.sub(r"-?\d[\d.e+-]*", "...", text)


def refusals(rows: Rows, size: int = 2) -> list[dict[str, Any]]:
    """Sentences that refuse compositions of a size, with the verb that first says it, by frequency.

    All verbs refuse a composition whose full model is refused: its sentence counts once.
    """
    seen: dict[tuple[str, str], dict[str, Any]] = {}
    counted: set[tuple[tuple[str, ...], str, str]] = set()
    order = ("full", *(verb for verb in COLUMNS if verb != "full"))
    rank = {verb: place for place, verb in enumerate(order)}
    refused = [row for row in rows if row["outcome"] == "refused"]
    ranked = [row for row in refused if len(row["capabilities"]) == size]
    for row in sorted(ranked, key=lambda one: rank.get(one["verb"], len(rank))):
        key = (row["place"], plain(row["reason"]))
        own = (tuple(row["capabilities"]), *key)
        if own in counted:
            continue
        counted.add(own)
        said = {name: row[name] for name in ("verb", "place", "reason")}
        item = seen.setdefault(key, {**said, "pairs": 0})
        item["pairs"] += 1
    return sorted(seen.values(), key=lambda item: (-item["pairs"], item["place"]))


def in_a_cell(text: str) -> str:
    """Text that Markdown shows as it is, in a cell of a table."""
    text = re.sub(r"0x[0-9a-f]+", "0x...", text.replace("\n", " "))
    return re.sub(r"([|*_<>`])", r"\\\1", text)


def faults(rows: Rows) -> list[str]:
    """Table of what is wrong, crashes or takes too long."""
    found = [row for row in rows if row["outcome"] in FAULTS]
    if not found:
        return ["None of these."]
    lines = ["| capabilities | verb | outcome | what |", "|---|---|---|---|"]
    for row in found:
        cells = (" + ".join(row["capabilities"]), row["verb"], row["outcome"], row["reason"][:300])
        lines.append("| " + " | ".join(map(in_a_cell, cells)) + " |")
    return lines


ABOUT = """# What composes

Made by `benchmarks/compose.py`: {names} capabilities, alone and in {pairs} of {every} pairs,
which are drawn at random; {rows} answers of verbs. A composition is a small scene
of two blocks with these capabilities, whose contact opens and closes along a load path. Each small
model is compared with the full one, gradients with differences, pages in node and C headers in a
compiler with Python.

{shares}

Left out are compositions that exclude each other by what they mean, such as axisymmetry and space,
and verbs with nothing to compare, such as the error of a model that reports none.
{neutral}
## Pairs

`F` the full model refuses, `K` condensation, `H` hyper-reduction, `P` pages or C headers, `G`
gradients: the first of them. `+` all verbs that ran answer, `x` excluded by what they mean, `!`
wrong, a crash or a time out; what did not run is blank. Singles are on the diagonal.

```text
{matrix}
```

## Refusals of pairs

Each verb refuses what the full model refuses. "Not built in" says that there is no other reason.

| pairs | first refused by | in | why | such as |
|---|---|---|---|---|
{refusals}

## Wrong answers, crashes, time outs

{faults}
"""
"""Text of the page."""
NEUTRAL = """
A capability with a neutral value, such as friction 0, changes outputs by {largest:.1g} at most, in
{count} compositions.
"""


def page(rows: Rows, names: list[str]) -> str:
    """The page of a report, without rows of capabilities that are no longer there."""
    rows = [row for row in rows if set(row["capabilities"]) <= set(names)]
    changes = [row["neutral"] for row in rows if row["neutral"] is not None]
    said = []
    for item in refusals(rows):
        why, example = (
            in_a_cell(text) for text in (reason(item["verb"], item["place"]), item["reason"])
        )
        said.append(f"| {item['pairs']} | {item['verb']} | `{item['place']}` | {why} | {example} |")
    neutral = NEUTRAL.format(largest=max(changes), count=len(changes)) if changes else ""
    return ABOUT.format(
        names=len(names),
        pairs=len({tuple(row["capabilities"]) for row in rows if len(row["capabilities"]) == 2}),
        every=len(names) * (len(names) - 1) // 2,
        rows=len(rows),
        shares="\n".join(share_lines(rows)),
        neutral=neutral,
        matrix="\n".join(matrix(rows, names)),
        refusals="\n".join(said),
        faults="\n".join(faults(rows)),
    )
