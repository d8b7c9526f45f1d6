"""Tables of the benchmark of composition: shares of outcomes, the matrix of pairs, sentences of refusals."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

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
    return {verb: {size: dict(sorted(n.items())) for size, n in own.items()} for verb, own in found.items()}


def share(counts: dict[str, int]) -> str:
    """Share of what works among what is not excluded; ``none``, with nothing to compare, is left out."""
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
    """One letter for a composition: the first verb that refuses it, ``!`` for a fault, ``+`` if all answer."""
    if set(outcomes.values()) & set(FAULTS):
        return "!"
    if "excluded" in outcomes.values():
        return "x"
    for verb in COLUMNS:
        if outcomes.get(verb) == "refused":
            return LETTERS[verb]
    return "+" if outcomes else " "


def matrix(rows: Rows, names: list[str]) -> list[str]:
    """Lines of the matrix of pairs, with singles on the diagonal; columns have the numbers of the rows."""
    outcomes: dict[frozenset[str], dict[str, str]] = defaultdict(dict)
    for row in rows:
        outcomes[frozenset(row["capabilities"])][row["verb"]] = row["outcome"]
    width = max(map(len, names))
    heads = [" " * (width + 4) + " ".join(f"{k + 1:02d}"[digit] for k in range(len(names))) for digit in (0, 1)]
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
    """Sentences that refuse compositions of a size, with the verb that first says it, most frequent first.

    A composition whose full model is refused is refused by all verbs: its sentence counts once, for the full model.
    """
    seen: dict[tuple[str, str], dict[str, Any]] = {}
    counted: set[tuple[tuple[str, ...], str, str]] = set()
    order = ("full", *(verb for verb in COLUMNS if verb != "full"))
    ranked = [row for row in rows if row["outcome"] == "refused" and len(row["capabilities"]) == size]
    for row in sorted(ranked, key=lambda one: order.index(one["verb"]) if one["verb"] in order else len(order)):
        key = (row["place"], plain(row["reason"]))
        own = (tuple(row["capabilities"]), *key)
        if own in counted:
            continue
        counted.add(own)
        item = seen.setdefault(key, {"verb": row["verb"], "place": row["place"], "reason": row["reason"], "pairs": 0})
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


def page(rows: Rows, names: list[str]) -> str:
    """The page of a report."""
    count = len({tuple(row["capabilities"]) for row in rows})
    changes = [row["neutral"] for row in rows if row["neutral"] is not None]
    lines = [
        "# What composes",
        "",
        f"Made by `benchmarks/compose.py`: {len(names)} capabilities, {count} compositions, {len(rows)} answers of "
        "verbs. A composition is a small scene of two blocks with these capabilities, whose contact opens and closes "
        "along a load path; each small model is compared with the full one, gradients with differences, pages in "
        "node and C headers in a compiler with Python.",
        "",
        *share_lines(rows),
        "",
        "Left out are compositions that exclude each other by what they mean, such as axisymmetry and space, and "
        "verbs with nothing to compare, such as the error of a model that reports none.",
        "",
    ]
    if changes:
        lines += [
            f"A capability with a neutral value, such as friction 0, changes outputs by {max(changes):.1g} at most, "
            f"in {len(changes)} compositions.",
            "",
        ]
    lines += [
        "## Pairs",
        "",
        "`F` the full model refuses, `K` condensation, `H` hyper-reduction, `P` pages or C headers, `G` gradients: the "
        "first of them. `+` all answer, `x` excluded by what they mean, `!` wrong, a crash or a time out. Singles are "
        "on the diagonal.",
        "",
        "```text",
        *matrix(rows, names),
        "```",
        "",
        "## Refusals of pairs",
        "",
        "| pairs | first refused by | in | such as |",
        "|---|---|---|---|",
    ]
    for item in refusals(rows):
        cells = (str(item["pairs"]), item["verb"], f"`{item['place']}`", in_a_cell(item["reason"]))
        lines.append("| " + " | ".join(cells) + " |")
    lines += ["", "## Wrong answers, crashes, time outs", "", *faults(rows)]
    return "\n".join(lines) + "\n"
