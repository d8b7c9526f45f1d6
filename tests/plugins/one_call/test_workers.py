"""Searches on several ranks: the first one decides, the others solve; the same model as by one."""

import json
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import contract
import numpy as np
from mpi4py import MPI
from mpirun import launch, run_program
from needs import needs

from hhr_dolfinx.contact.law import UNILATERAL
from hhr_dolfinx.errors import ConvergenceError
from hhr_dolfinx.plugins.one_call.workers import Workers

SCENE = f"""
import sys
sys.path[:0] = {[str(Path(contract.__file__).parent)]!r}
import contract
import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.plugins.moduli.condense import Condensation

def refuse(self, task):  # ranks share trainings, which a search without condensation needs
    raise NotOfferedError("none of these")

Condensation.check = refuse
scene = contract.blocks(("E1", 0.3), free=True, box={{"E1": (2.0, 4.0)}})
"""
SEARCH = """
import json
from mpi4py import MPI
model = hhr.reduce(scene, 0.02, of="forces", folder=sys.argv[1])
tried = [
    [item.method, item.setting, item.full_answers, item.errors] for item in model.reduction.tried
]
forces = model.solve(model.parameters.middle).forces().tolist()
every = MPI.COMM_WORLD.gather([tried, forces])
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps(every))
"""
FAILS = """
from mpi4py import MPI
full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
if MPI.COMM_WORLD.rank == 1:
    full.solve = lambda point: 1 / 0
try:
    hhr.reduce(full, 0.02, of="forces")
except Exception as error:
    print(f"{MPI.COMM_WORLD.rank}: {type(error).__name__}: {error}", flush=True)
"""


@needs("moduli")
def test_a_search_on_two_ranks_is_that_on_one(tmp_path):
    """What was tried and how exact it is, and the answers of the model, on both.

    Full answers are kept by both.
    """
    said = (
        launch(ranks, ["-c", SCENE + SEARCH, str(tmp_path / name)])
        for ranks, name in ((1, "one"), (2, "two"))
    )
    alone, both = (json.loads(text.splitlines()[-1]) for text in said)
    assert len(both) == 2 and both[0] == both[1]
    (tried, forces), (other, found) = alone[0], both[0]
    assert [item[:3] for item in tried] == [item[:3] for item in other] and tried[-1][1].endswith(
        "training points"
    )
    np.testing.assert_allclose(found, forces, rtol=0, atol=1e-12 * max(forces))
    for folder in ("one", "two"):
        kept = json.loads((tmp_path / folder / "reduction.json").read_text())
        assert kept["met"] and (tmp_path / folder / "model.npz").is_file()
    stored = [
        sorted(path.name for path in (tmp_path / name / "snapshots").rglob("*.npz"))
        for name in ("one", "two")
    ]
    assert stored[0] == stored[1] and len(stored[0]) >= tried[-1][2]


@needs("moduli")
def test_a_rank_that_fails_ends_a_search_in_words():
    """What is wrong with one rank is said by all, and none waits for it."""
    run = run_program(2, ["-c", SCENE + FAILS], limit=60)
    assert run.stdout.count("failed on another rank: ZeroDivisionError: division by zero") == 2, (
        run.stdout
    )
    assert "0: RuntimeError" in run.stdout and "1: RankError" in run.stdout


@needs("moduli")
def test_a_command_searches_on_two_ranks(tmp_path):
    (tmp_path / "scene.py").write_text(SCENE)
    program = "from hhr_dolfinx.command.main import hhr; hhr()"
    run = run_program(
        2, ["-c", program, "reduce", "scene.py", "--error", "2%", "--of", "forces"], tmp_path
    )
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-2000:]
    assert run.stdout.count("is met") == 1 and len(list(tmp_path.rglob("model.npz"))) == 1


def test_what_has_no_answer_is_told_and_not_raised():
    class Full:
        law = UNILATERAL
        strains = SimpleNamespace(paused=nullcontext)

        def solve(self, point):
            if point[0] > 1:
                raise ConvergenceError("too much")
            return float(point[0])

    found = Workers(MPI.COMM_SELF, Full(), None).solved([np.array([0.5]), np.array([2.0])])
    assert found[0] == 0.5 and isinstance(found[1], ConvergenceError)
