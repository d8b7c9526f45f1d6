"""Models that ranks build together, each with the rows of its own dofs: those of one rank, and no
rank has all rows.
"""

import json

import numpy as np
import pytest
from mpirun import launch
from needs import needs, present
from processes import folders_of
from scipy.sparse import random_array

import hhr_dolfinx as hhr
from hhr_dolfinx.group import group_of
from hhr_dolfinx.linear.rows import rows_of

PROGRAM = """
import dataclasses, json, sys, warnings
sys.path[:0] = {folders!r}
import numpy as np
from mpi4py import MPI
import test_rows, toy_steps, your_scene
from needs import present
from scenes import lying
import hhr_dolfinx as hhr
warnings.simplefilter("ignore")
comm = MPI.COMM_WORLD
out = {{"tables": test_rows.of_tables(comm)}}
plain = your_scene.scene()
spring, roller, stop = plain.bodies
bodies = spring, dataclasses.replace(roller, young="E"), stop
box = hhr.ParameterSpace(("travel", "lowered", "E"), (0.05, 0.0, 2e3), (1.0, 0.3, 5e3))
scenes = {{"outputs": plain}}
if present("floating"):
    scenes = {{"contact alone holds": lying(cells=(16, 8), tilt=0.2), **scenes}}
if present("moduli"):
    varying = dataclasses.replace(plain, bodies=bodies, parameters=box)
    scenes = {{"moduli that vary": varying, **scenes}}
recipes = {{
    "usual": hhr.Recipe(trust=None), "cone": hhr.Recipe(trust=None, cone=True),
    "energy": hhr.Recipe(hhr.Pod(1e-6, norm="energy"), trust=None),
    "L2": hhr.Recipe(hhr.Pod(1e-6, norm="l2"), trust=None),
    "by body": hhr.Recipe(hhr.Pod(1e-10, by_body=True), trust=None),
}}
for name, scene in scenes.items():
    how = dict(held_out=4, together=True, folder=f"{folder}/{{name}} {{comm.size}}")
    training = hhr.train(scene, hhr.Sobol(12), **how)
    size = training.full_order.problem.free.size
    out["rows " + name] = [comm.allgather(len(training.snapshots.displacements)), size]
    asked = training.full_order.parameters.random(3, 5)
    for kind, recipe in recipes.items():
        model = training.build(recipe)
        found = [model.solve(point, outside="ignore") for point in asked]
        stages = [item["stage"] for item in model.offline.log.skipped]
        out[f"own {{name}} {{kind}}"] = comm.allgather([len(model.offline.basis), stages])
        values = [float(np.linalg.norm(answer.displacement())) for answer in found]
        values += [float(np.linalg.norm(answer.forces())) for answer in found]
        for answer in found if scene.outputs else ():
            values += [float(value) for value in answer.outputs().values.values()]
        told = [answer.estimate() for answer in found]
        if kind == "usual" and told[0].kind == "bound":
            keys = "primal", "dual", "forces_euclid"
            out[f"bounds {{name}}"] = [getattr(one, key) for one in told for key in keys]
            out[f"over {{name}}"] = over = []
            for point, answer, one in zip(asked, found, told, strict=True):
                off = answer.forces() - training.full_order.solve(point).forces()
                over.append(one.forces_euclid - float(np.linalg.norm(off)))
        out[f"{{name}} {{kind}}"] = values
again = hhr.train(scene, hhr.Sobol(12), **how)
out["read"] = again.read
out["same"] = float(np.abs(again.snapshots.displacements - training.snapshots.displacements).max())
# a step of one's own that knows nothing of rows gets all of them
own = training.build(hhr.Recipe(toy_steps.EveryKth(1), trust=None))
fields = [own.solve(point, outside="ignore").displacement() for point in asked]
out["toy"] = [float(np.linalg.norm(field)) for field in fields]
out["told"] = [item["why"] for item in own.offline.log.skipped if item["stage"] == "rows of ranks"]
if present("fallback"):
    safe = training.safe_model(0.05, checked=False)
    out["safe"] = [float(np.linalg.norm(safe.solve(point).forces())) for point in asked]
if present("greedy"):
    choosing = hhr.Greedy(budget=10, start=hhr.Sobol(4), candidates=hhr.Sobol(16), together=3)
    greedy = hhr.train(scene, choosing, held_out=0, together=True)
    out["greedy"] = [len(greedy.snapshots.points), len(greedy.snapshots.displacements)]
out["refused"] = {{}}
for kind in (test_rows.Nowhere, test_rows.Wider, test_rows.OwnNodes):
    step = kind()
    own = {{"basis": step}} if hasattr(step, "modes") else {{"nodes": (hhr.Deim(), step)}}
    try:
        training.build(hhr.Recipe(trust=None, **own))
    except hhr.errors.ReductionError as error:
        out["refused"][kind.__name__] = comm.allgather(str(error))
if comm.rank == 0:
    print(json.dumps(out))
"""


def of_tables(comm):
    """What rows do, beside numpy on the whole tables; the first of three ranks has none."""
    count = 23
    cuts = (
        np.linspace(0, count, comm.size + 1).astype(int)
        if comm.size < 3
        else np.array([0, 0, 9, count])
    )
    rows = rows_of(slice(*cuts[comm.rank : comm.rank + 2]), count, group_of(comm))
    draw = np.random.default_rng(1)
    table = draw.standard_normal((count, 40))
    table[:, 7] = table[:, 6]
    table[5] = table[17]  # equal rows
    matrix = random_array((count, count), density=0.3, rng=draw, format="csr")
    own = rows.of(table)
    product = rows.matrix(rows.of(matrix.tocsr()))
    places = np.array([17, 3, 5, 22, 0])
    turned, triangle = rows.orthonormal(np.asfortranarray(own[:, :12]))
    whole = rows.whole(turned)
    sizes = np.abs(table).sum(axis=1)
    largest = rows.largest(np.abs(own).sum(axis=1))
    off = {
        "whole": np.abs(rows.whole(own) - table).max(),
        "vector": np.abs(rows.whole(own[:, 0]) - table[:, 0]).max(),
        "at": np.abs(rows.at(own, places) - table[places]).max(),
        "sum": np.abs(rows.sum(own.T @ own) - table.T @ table).max(),
        "number": abs(rows.sum(float(own.sum())) - table.sum()),
        "norms": np.abs(rows.norms(own) - np.linalg.norm(table, axis=0)).max(),
        "mine": np.abs(rows.sum(float(rows.mine(places).size)) - places.size),
        "product": np.abs(rows.whole(product @ own) - matrix @ table).max(),
        "product of a vector": np.abs(rows.whole(product @ own[:, 3]) - matrix @ table[:, 3]).max(),
        "absolute": np.abs(rows.whole(abs(product) @ own) - abs(matrix) @ table).max(),
        "behind an absolute": np.abs(rows.whole(product @ own) - matrix @ table).max(),
        "orthonormal": np.abs(whole.T @ whole - np.eye(whole.shape[1])).max(),
        "spanned": np.abs(whole @ triangle - table[:, :12]).max(),
        "largest": abs(largest[0] - sizes.argmax()) + abs(largest[1] - sizes.max()),
    }
    return {name: comm.allgather(float(value)) for name, value in off.items()}


class Nowhere:
    """A basis that is not finite, on one rank alone."""

    by_rows = True

    def modes(self, problem, snapshots):
        found = np.linalg.qr(snapshots.displacements)[0]
        return found if problem.first else np.full_like(found, np.nan)


class Wider:
    """A basis with one mode more on the first rank than on others."""

    by_rows = True

    def modes(self, problem, snapshots):
        return hhr.Pod(1e-9).modes(problem, snapshots)[:, : 5 - bool(problem.first)]


class OwnNodes:
    """Nodes of this rank alone."""

    by_rows = True

    def nodes(self, problem, snapshots, basis):
        return np.array([problem.first // problem.block_size])


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Numbers by the number of ranks, each when they are first asked for."""
    folder = str(tmp_path_factory.mktemp("rows"))
    program = PROGRAM.format(folders=folders_of(__file__), folder=folder)

    class Found(dict):
        def __missing__(self, ranks):
            self[ranks] = json.loads(launch(ranks, ["-c", program]).splitlines()[-1])
            return self[ranks]

    return Found()


THREE = pytest.param(3, marks=pytest.mark.slow)


@pytest.mark.parametrize("ranks", [1, 2, THREE])
def test_tables_of_ranks_are_those_of_numpy(found, ranks):
    """Sums of some dozen products of numbers of size 1."""
    for name, values in found[ranks]["tables"].items():
        assert len(values) == ranks and max(values) < 1e-13, name


NAMES = (
    *(["moduli that vary"] if present("moduli") else []),
    *(["contact alone holds"] if present("floating") else []),
    "outputs",
)
KINDS = ("usual", "cone", "energy", "L2", "by body")


@pytest.mark.parametrize("ranks", [1, 2, THREE])
def test_no_rank_has_the_answers_or_the_basis_of_another(found, ranks):
    for name in NAMES:
        shares, size = found[ranks]["rows " + name]
        assert sum(shares) == size and max(shares) < 1.3 * size / ranks, name
        for kind in KINDS:
            own = found[ranks][f"own {name} {kind}"]
            assert [rows for rows, _ in own] == shares, (name, kind)
            assert not any("rows of ranks" in stages for _, stages in own), (name, kind)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("ranks", [2, THREE])
def test_models_of_ranks_are_those_of_one(found, ranks, name):
    """Fields, forces and outputs; of scenes without mirror images, of which DEIM might pick
    either.
    """
    for kind in KINDS:
        one, several = found[1][f"{name} {kind}"], found[ranks][f"{name} {kind}"]
        assert several == pytest.approx(one, rel=1e-8), kind


@needs("exact_errors")
@pytest.mark.parametrize("ranks", [1, 2, THREE])
def test_bounds_of_ranks_hold(found, ranks):
    """Where moduli vary that of the displacement is a difference of energies, which leaves half of
    the digits.

    Bounds of forces on all conditions are the round-off of these. Where contact alone holds a body
    these models are exact to 1e-9, and what is left of their bounds is the round-off that they
    allow, 1e-10 of sums of forces.
    """
    for name in NAMES:
        one, several = (found[count][f"bounds {name}"] for count in (1, ranks))
        assert min(found[ranks][f"over {name}"]) >= 0.0, name
        least = 1e-9 if name == "contact alone holds" else 1e-11
        assert several == pytest.approx(
            one, rel=1e-3, abs=least * max(found[1][f"{name} usual"])
        ), name


@pytest.mark.parametrize("ranks", [1, 2, THREE])
def test_answers_that_are_kept_are_found_by_rows(found, ranks):
    assert found[ranks]["read"] == 16 and found[ranks]["same"] < 1e-14


@pytest.mark.parametrize("ranks", [1, 2, THREE])
def test_what_knows_nothing_of_rows_gets_all_of_them(found, ranks):
    """A basis of one's own, a model that falls back on the full one, a training that chooses.

    Of two nodes with the same residuals DEIM may pick either: the basis, of few snapshots, makes an
    error of 1e-5.
    """
    mine = found[ranks]
    told = (
        "each rank has all rows of all matrices and answers: a step of the recipe does not say "
        "by_rows = True"
    )
    assert mine["told"] == [told] * (ranks > 1)
    for name in ("toy", "safe") if present("fallback") else ("toy",):
        assert mine[name] == pytest.approx(found[1][name], rel=1e-5), name
    if present("greedy"):
        assert mine["greedy"] == [10, found[1]["rows outputs"][1]]


@pytest.mark.parametrize("ranks", [1, 2, THREE])
def test_what_is_wrong_on_one_rank_is_refused_on_all(found, ranks):
    words = {"Nowhere": "modes of <test_rows.Nowhere"}
    if ranks > 1:
        words |= {
            "Wider": "other numbers of modes on other ranks",
            "OwnNodes": "other nodes on other ranks",
        }
    assert found[ranks]["refused"].keys() == words.keys()
    for kind, texts in found[ranks]["refused"].items():
        assert len(texts) == ranks and all(words[kind] in text for text in texts), kind
