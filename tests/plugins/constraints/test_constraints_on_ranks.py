"""Constraints, preload and springs on several ranks: the same numbers as on one."""

import json

import numpy as np
import pytest
from mpirun import launch
from needs import needs, present
from processes import folders_of

PROGRAM = """
import json, sys
from pathlib import Path
sys.path[:0] = {folders!r}
import numpy as np
import hhr_dolfinx as hhr
from dataclasses import replace
from hhr_dolfinx.geometries import block
from tied_blocks import TOP, pressed, tied
from bolted_columns import column, scene as bolt
from mpi4py import MPI
comm = MPI.COMM_WORLD
out = {{}}

def note(name, model, point):
    answer = model.solve(point)
    points = model.full.problem.points.round(9)
    u = answer.displacement().reshape(points.shape)
    # nodes of both sides of a surface have one place
    ordered = [np.lexsort((part, *points.T)) for part in u.T]
    out[name + ", displacement"] = [part[order].tolist() for part, order in zip(u.T, ordered)]
    out[name + ", forces"] = answer.forces().tolist()
    return answer

ends = [hhr.Nodes.near((x, 1.0)) for x in (0.0, 1.0)]
half = hhr.Nodes(lambda x: np.isclose(x[1], 1) & (x[0] < 0.3))
soft = tuple(hhr.Body(tag, young=young, poisson=0.3) for tag, young in ((1, "E"), (2, 100.0)))
box = {{"p": (0.1, 1.0), "E": (50.0, 200.0)}}
path = Path({folder!r}) / f"bolt {{comm.size}}.inp"
if comm.rank == 0:
    column(path)
comm.barrier()
near = hhr.Obstacle(block.side(0, upper=True), (1, 0), 1.0)
bedding = hhr.Springs(TOP, 1, 30.0, "0.01 * p", bedding=True)
grounded = pressed(loads=(hhr.Pressure(TOP, "p"), bedding))
twice = hhr.Equation(((ends[0], 1, 1.0), (ends[1], 1, -2.0)), "0.002 * p")
pushed = hhr.NodalForce(half, (0.0, -0.4), "p")
serendipity = pressed((hhr.Serendipity(), hhr.MeanMotion(TOP, 1, "-0.01 * p")))
space = hhr.ParameterSpace(tuple(box), *zip(*box.values()))
loads = hhr.BoltForce("CUT", "-5 * p"), hhr.Springs("HEAD", 2, 50.0, bedding=True)
scenes = {{
    "tied": (tied(wall=1.0005, pairing=hhr.NodeToSurface), [0.9]),
    "tied, modulus": (
        tied(wall=1.0005, box=box, bodies=soft, pairing=hhr.NodeToSurface), [0.9, 150.0]
    ),
    "equation": (pressed((twice,)), [0.7]),
    "rigid": (pressed((hhr.RigidMotion(TOP),), loads=(pushed,)), [0.7]),
    "mean": (pressed((hhr.MeanMotion(TOP, 1, "-0.01 * p"),), loads=()), [0.7]),
    "serendipity": (
        replace(serendipity, order=2, outputs=(hhr.ElasticEnergy("energy"),)), [0.7]
    ),
    "preload": (bolt(path, (hhr.Preload("CUT", "-0.01 * p"),), gap=0.002), [0.8]),
    "force": (bolt(path, (hhr.ForcedSection("CUT"),), loads), [0.8]),
    "springs": (grounded, [0.9]),
    "springs, modulus": (
        replace(grounded, bodies=(hhr.Body(block.SOLID, "E", 0.3),), parameters=space), [0.9, 70.0]
    ),
}}
for name, (scene, point) in scenes.items():
    if scene.name == "bolt" and comm.size > 2:  # three cells are too few for three ranks
        continue
    scene = replace(scene, contacts=(near,)) if scene.name == "pressed" else scene
    full = hhr.FullOrderModel(scene)
    answer = note(name, full, point)
    out[name + ", stress"] = float(np.linalg.norm(answer.stress()))
    outputs = answer.outputs().values.values() if scene.outputs else []
    out[name + ", outputs"] = [float(value) for value in outputs]
    problem = full.problem
    if name in ("tied", "preload", "springs"):
        whole = problem.gathered(comm)
        out[name + ", entries"] = [whole.stiffness.nnz, float(abs(whole.stiffness).sum())]
        assert len(problem.bodies) == 1
        note(name + ", gathered", full.gathered(), point)
    if name in ("tied, modulus", "equation", "preload", "springs"):
        training = hhr.train(scene, hhr.Sobol(8), held_out=2, together=True)
        for kind, model in (("condensed", training.condense()), ("reduced", training.build())):
            out[f"{{name}}, {{kind}}"] = model.solve(point).forces().tolist()
    if (prolongation := problem.prolongation).map is not None:
        u = full.solve(point).displacement() - problem.lifts @ problem.theta(point).values
        assert np.abs(prolongation.broken(u[:, None])).max() < 1e-12
    if comm.size > 1:
        assert not problem.whole
laws = (1, hhr.Plasticity(0.5, 20.0)), (2, hhr.Norton(3.0, 3.0))
yielding = tied(wall=1.0005, pairing=hhr.NodeToSurface,
                bodies=[hhr.Body(tag, 100.0, 0.3, law) for tag, law in laws])
yielding = replace(yielding, bodies=tuple(yielding.bodies),
                   loads=(*yielding.loads, hhr.Springs(200 + TOP, 1, 3.0)))
steps = [(float(k), [p]) for k, p in enumerate((0.1, 0.5, 1.0))]
for search in ("elastic", "tangent") if {laws} else ():
    settings = hhr.MarchSettings(search=search)
    last = hhr.FullOrderModel(yielding).march(steps, settings).answers[-1]
    out["laws, forces " + search] = last.forces().tolist()
    out["laws, flowed " + search] = float(np.linalg.norm(last.plastic_strain()))
if comm.rank == 0:
    print(json.dumps(out))
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = str(tmp_path_factory.mktemp("decks"))
    program = PROGRAM.format(laws=present("inelastic"), folders=folders_of(__file__), folder=folder)
    known = {}

    def on(ranks):
        if ranks not in known:
            known[ranks] = json.loads(launch(ranks, ["-c", program]).splitlines()[-1])
        return known[ranks]

    return on


@needs("nonmatching", "moduli", "nodal_loads", "stress", "second_order")
@pytest.mark.parametrize("ranks", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_ranks_do_not_change_constrained_answers(found, ranks):
    """Round-off only: 1e-10, as factors order their sums in another way.

    3e-6 between RIDs of other node numbers.
    """
    serial, parallel = found(1), found(ranks)
    assert {
        name for name in serial if ranks == 2 or not name.startswith(("preload", "force"))
    } == parallel.keys()
    for name in parallel:
        value = serial[name]
        size = np.abs(np.concatenate([np.ravel(value), [0.0]])).max()
        near = 1e-5 if "reduced" in name else 1e-10
        assert np.ravel(parallel[name]) == pytest.approx(
            np.ravel(value), rel=near, abs=near * size
        ), name
    assert all(max(value) > 0 for name, value in serial.items() if name.endswith("forces"))
    assert (
        not present("inelastic")
        or min(serial["laws, flowed elastic"], serial["laws, flowed tangent"]) > 1e-3
    )


ENERGIES = """
import json, sys
sys.path[:0] = {folders!r}
import numpy as np
import hhr_dolfinx as hhr
from dataclasses import replace
from mpi4py import MPI
from scenes import space
from tied_blocks import RIGHT, TOP, pressed

comm = MPI.COMM_WORLD
ends = [hhr.Nodes.near((x, 1.0)) for x in (0.0, 1.0)]
out, fallen = [], []
for value in (0.0, "0.002 * p"):
    scene = pressed((hhr.Equation(((ends[0], 1, 1.0), (ends[1], 1, -2.0)), value),), cells=(8, 8))
    box = space(p=(0.1, 1.0), q=(-0.1, 0.1))
    scene = replace(scene, contacts=(hhr.Obstacle(RIGHT, (1, 0), 1.0005),), parameters=box,
                    loads=(hhr.Pressure(TOP, "p"), hhr.Pressure(RIGHT, "q")))
    training = hhr.train(scene, hhr.Sobol(8), held_out=2, together=True)
    model = training.build(hhr.Recipe.thesis(1e-3).as_it_is(), checked=False)
    full = training.full_order
    plain = hhr.FullOrderModel(replace(scene, constraints=())).gathered().problem.stiffness
    size = lambda field: float(np.sqrt(field @ (plain @ field)))
    for mu in ([0.2, 0.05], [0.9, -0.05]):
        answer, exact = model.solve(mu), full.solve(mu).displacement()
        off, estimate = size(answer.displacement() - exact), answer.estimate()
        out.append([estimate.primal / off, estimate.primal_relative * size(exact) / off])
    # every rank falls back at the same points, and no rank waits for another
    cheap = hhr.FallbackModel(model, full, 0.06, of="displacement")
    for mu in ([0.2, 0.05], [0.9, -0.05], [0.6, 0.09]):
        cheap.solve(mu)
    fallen.append([cheap.asked, cheap.fallen])
    for again in (0, 1):
        store = hhr.SnapshotStore({folder!r}, full)
        hhr.compute_snapshots(full, np.array([[0.4, 0.01]]), store=store)
        why = "the store knows an answer by a fingerprint that is that of all ranks"
        assert store.found == again, why
every = comm.allgather((out, fallen))
assert all(one == every[0] for one in every), every
if comm.rank == 0:
    print(json.dumps([out, fallen]))
"""


@needs("exact_errors", "fallback", "ranks")
def test_energies_are_those_of_all_ranks(tmp_path):
    """Estimates are the errors by K of the same mesh without the equation, alike on all ranks, and
    none waits.
    """
    program = ENERGIES.format(folders=folders_of(__file__), folder=str(tmp_path))
    ratios, fallen = json.loads(launch(2, ["-c", program]).splitlines()[-1])
    assert np.array(ratios) == pytest.approx(1.0, abs=0.1)
    assert all(asked > 0 for asked, _ in fallen)
