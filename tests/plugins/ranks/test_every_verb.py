"""Each command of ``hhr`` and each verb of the API on several ranks: the numbers of one rank, or a
refusal.
"""

import json
import re

import every
import numpy as np
import pytest
from mpirun import launch
from needs import OURS, needs
from processes import folders_of

import hhr_dolfinx as hhr
from hhr_dolfinx import registry

PROGRAM = f"""
import json, sys
sys.path[:0] = {folders_of(__file__)!r}
import every
found = every.outcomes(json.loads(sys.argv[1]), sys.argv[2])
if every.COMM.rank == 0:
    print(json.dumps(found))
"""
EVERY_DAY = [
    "hhr solve",
    "hhr answer",
    "full.solve",
    "full.march",
    "training.condense",
    "hhr.answer_points",
]
"""Entries of `make test`, on two ranks; all others are those of `make slow`."""
SAME = 1e-10


@needs(*OURS)
def test_every_command_and_every_verb_has_an_entry():
    """A new one without an entry fails here."""
    assert {name.split()[0] for name in every.COMMANDS} == set(every.command.list_commands(None))
    verbs = {name for name in hhr.__all__ if name.islower() and callable(getattr(hhr, name))}
    assert set(every.FUNCTIONS) | set(every.CALLED) == verbs
    of_trainings = {"build", "condense", *registry.named("kinds"), *registry.named("methods")}
    assert {name.split()[0] for name in every.KINDS} == of_trainings


@pytest.fixture(scope="module")
def serial(tmp_path_factory):
    return {
        name: found[0]
        for name, found in every.outcomes(every.ENTRIES, tmp_path_factory.mktemp("serial")).items()
    }


def check(found, serial):
    """Each rank has the numbers of one rank, or all raise an error that names ranks."""
    for name, outcomes in found.items():
        if all(
            isinstance(own, str) for own in outcomes
        ):  # the words of a command are those of one rank
            assert re.search(r"\branks?\b", " ".join(outcomes)), (name, outcomes)
            continue
        for own in outcomes:
            assert not isinstance(own, str) and not isinstance(serial[name], str), (
                name,
                own,
                serial[name],
            )
            assert len(own) == len(serial[name]), name
            size = np.abs(serial[name]).max(initial=1e-300)
            assert np.abs(np.subtract(own, serial[name])).max(initial=0.0) <= SAME * size, name


def run(ranks, names, folder):
    return json.loads(
        launch(ranks, ["-c", PROGRAM, json.dumps(list(names)), str(folder)]).splitlines()[-1]
    )


@needs("tables")
def test_every_day(tmp_path):
    serial, found = (tmp_path / name for name in ("serial", "ranks"))
    serial.mkdir()
    found.mkdir()
    expected = {name: outcomes[0] for name, outcomes in every.outcomes(EVERY_DAY, serial).items()}
    check(run(2, EVERY_DAY, found), expected)


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [2, 3])
def test_all(serial, tmp_path, ranks):
    check(run(ranks, every.ENTRIES, tmp_path), serial)
