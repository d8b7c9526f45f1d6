"""Figures of README: all of them are those that ``make figures`` measured, and no other one is quoted."""

import importlib
import json
import re

import figures
import pytest
from mpi4py import MPI
from needs import present

import hhr_dolfinx as hhr

README = figures.README.read_text()
KEPT = json.loads(figures.FILE.read_text())
DOCS = sorted((figures.ROOT / "docs").glob("*.md"))
QUOTED = re.compile(r"\d[\d.,]* ?(?:ms|us|µs|%|times)(?![\w-])|\d+ queries")
"""A time of an answer, a ratio, an error, or a break-even."""


def test_the_table_of_readme_is_that_of_the_file():
    assert figures.with_table(README, KEPT) == README
    assert KEPT


def test_a_changed_figure_is_seen():
    name = next(iter(KEPT))
    changed = KEPT | {name: KEPT[name] | {"N": KEPT[name]["N"] + 1}}
    assert figures.with_table(README, changed) != README


def test_readme_quotes_no_figure_outside_of_the_table():
    """Options of commands in its blocks of code, such as a tolerance, are no figures."""
    before, rest = README.split(figures.BEGIN)
    text = re.sub(r"```.*?```", "", before + rest.split(figures.END)[1], flags=re.DOTALL)
    text = re.sub(r"`[^`]*`", "", text)
    assert QUOTED.findall(text) == []
    found = QUOTED.findall("69 ms, 208 times, 0.10 / 0.21 %, 47 queries")
    assert found == ["69 ms", "208 times", "0.21 %", "47 queries"]


def test_scripts_of_the_table_are_there_and_make_runs_them():
    makefile = (figures.ROOT / "Makefile").read_text()
    assert set(KEPT) <= set(figures.SOURCES)
    for source in figures.SOURCES.values():
        assert (figures.ROOT / source.script).exists()
        assert re.search(rf"^{source.target}: setup\n\t.venv/bin/python {source.script}", makefile, re.MULTILINE)


@pytest.mark.slow
def test_sizes_in_the_file_are_those_of_the_scenes():
    """Sizes are counted again where that takes seconds; times and errors are those of the day that the file names."""
    for name in {"hertz_half_discs", *(["fretting"] if present("friction") else [])} & set(KEPT):
        problem = hhr.FullOrderModel(importlib.import_module(name).scene(), MPI.COMM_SELF).problem
        assert (problem.free.size, problem.contact.shape[0]) == (KEPT[name]["N"], KEPT[name]["N_lambda"]), name


@pytest.mark.parametrize("page", [figures.README, *DOCS], ids=lambda page: page.stem)
def test_no_page_quotes_what_no_longer_holds(page):
    """Times of a full order that is gone, and what models with friction refused once."""
    stale = "69 ms|47 queries|0.33 ms|times the full order, 208|refused by local models|3700 tests"
    assert not re.search(stale, page.read_text())
