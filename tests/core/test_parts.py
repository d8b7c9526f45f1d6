"""Parts of a training, and of a table, that know nothing of each other but a folder."""

from __future__ import annotations

import contract
import numpy as np
import pytest
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, StudyError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.group import share
from hhr_dolfinx.study.training.train import train_part


@pytest.mark.parametrize("count", [0, 1, 7, 8, 20])
def test_every_place_is_in_one_part(count):
    shares = [list(share(count, number, 8)) for number in range(8)]
    assert [place for part in shares for place in part] == list(range(count))
    assert max(map(len, shares)) - min(map(len, shares)) <= 1


def test_a_training_reads_what_its_parts_have_solved(tmp_path, monkeypatch):
    """In whatever order they ran, one of them twice; what is left are points where contact grazes."""
    how = hhr.Sobol(8), {"held_out": 10, "seed": 3}
    alone = hhr.train(contract.blocks(), how[0], **how[1])
    for number in (3, 1, 2, 3):
        found = train_part(contract.blocks(), how[0], number, 3, tmp_path, **how[1])
    assert (found.training, found.held_out, found.read) == (2, 2, 4)
    solved = []
    plain = FullOrderModel.solve
    monkeypatch.setattr(FullOrderModel, "solve", lambda *given, **how: solved.append(1) or plain(*given, **how))
    training = hhr.train(contract.blocks(), how[0], folder=tmp_path, **how[1])
    assert training.read == 16 and len(solved) == 2
    np.testing.assert_array_equal(training.snapshots.points, alone.snapshots.points)
    np.testing.assert_array_equal(training.held_out.points, alone.held_out.points)
    np.testing.assert_allclose(training.snapshots.forces, alone.snapshots.forces, rtol=1e-9, atol=1e-12)


@needs("friction")
def test_histories_have_parts_too(tmp_path):
    """Where contact rubs; the paths held out as well."""
    scene = contract.blocks(friction=0.2)
    lower, upper = np.array([scene.parameters.lower, scene.parameters.upper])
    paths = [[(0.0, lower), (1.0, lower + share * (upper - lower))] for share in (0.5, 0.8, 1.0)]
    for number in (1, 2):
        train_part(scene, paths[:2], number, 2, tmp_path, held_out=paths[2:])
    training = hhr.train(scene, paths[:2], held_out=paths[2:], folder=tmp_path)
    assert training.read == 3  # the first answer of a path is its rest


@pytest.mark.parametrize("part", [(0, 3), (4, 3), (1, 0), (1.5, 3)])
def test_no_such_part(part, tmp_path):
    with pytest.raises(StudyError, match="part"):
        train_part(contract.blocks(), hhr.Sobol(8), *part, tmp_path)


@needs("greedy")
def test_a_greedy_training_has_none(tmp_path):
    with pytest.raises(NotOfferedError, match="greedy"):
        train_part(contract.blocks(), hhr.Greedy(budget=10), 1, 2, tmp_path)
