"""The same numbers on 1, 2 and 3 ranks."""

import json

import numpy as np
import pytest
from mpirun import launch, run_program
from needs import needs, present
from numbers_of_ranks import assert_same, numbers_of_ranks
from processes import SCENE_FOLDERS

PROGRAM = """
full_order = hhr.FullOrderModel(demo.scene())
for mu in (0.15, 0.3123, 0.45):
    note(mu, full_order.solve(mu))
snapshots = hhr.compute_snapshots(full_order, full_order.problem.parameters.grid([31]))
reduction = hhr.build(full_order, snapshots, demo.THESIS)

problem = full_order.problem
whole = problem.gathered(comm)
def ordered(problem):
    "Dofs in an order of the places, which is that of all ranks."
    nodes = np.lexsort(problem.points.round(9).T)
    return (problem.block_size * nodes[:, None] + np.arange(problem.block_size)).ravel()

dofs = ordered(problem)
probe = np.sin(np.arange(dofs.size))
vectors = {{"K x": whole.stiffness[dofs][:, dofs] @ probe}}
vectors |= {{"M x": whole.mass[dofs][:, dofs] @ probe}}
vectors |= {{"loads": whole.loads[dofs].toarray(), "external": whole.external[dofs].toarray()}}
out |= {{name: np.ravel(value).tolist() for name, value in vectors.items()}}
for name, parts in (("stiffness", problem.stiffness_terms), ("mass", (problem.node_mass,))):
    entries = comm.allreduce(sum(part.nnz for part in parts))
    out[f"entries of {{name}}"] = entries
    out[f"share of {{name}}"] = comm.allgather(sum(part.nnz for part in parts) / entries)
out["rows"] = comm.allgather((problem.rows.start, problem.rows.stop, problem.whole))
out["whole"] = comm.allgather((whole.whole, whole is problem, full_order.gathered() is full_order))

held = {{
    "build": lambda: hhr.build(full_order.gathered(), snapshots, demo.THESIS),
    "stiffness": lambda: problem.stiffness,
    "wrong ranks": lambda: problem.gathered(MPI.COMM_SELF),
}}
out["said"] = {{name: comm.allgather(said(action)) for name, action in held.items()}}
out["kept"] = []
for place, model in (("rows", full_order), ("all rows", full_order.gathered())):
    kept = hhr.SnapshotStore(f"{folder}/{{place}} {{comm.size}}", model)
    for _ in range(2):
        again = hhr.compute_snapshots(full_order, snapshots.points[:3], store=kept)
    off = np.linalg.norm(again.displacements - snapshots.displacements[:, :3])
    out["kept"].append((off, kept.found))
compared = compare_points(full_order, reduction, snapshots.take([3]), 1.0)
out["compared"] = float(compared.primal[0] < 0.01 and compared.dual[0] < 0.05)
solid = hhr.FullOrderModel(pressed_block("solid", simplices=True))
answer = solid.solve(0.05)
out["solid"] = answer.forces().tolist()
# without columns of K^-1 B^T, in blocks that are the same on ranks with more and with fewer dofs
kept_bytes, limits.RESPONSE_BYTES = limits.RESPONSE_BYTES, 0
numbers, sparse.SOLVED_NUMBERS = sparse.SOLVED_NUMBERS, 4e3
pressed = hhr.FullOrderModel(sphere_on_block.scene(sphere_cells=(6, 3), block_cells=(5, 3)))
note("condensed", hhr.condense(pressed).solve([0.2, 50.0]))
# so large that ranks leave what is none of S beside it
finer = sphere_on_block.scene(pairing, sphere_cells=(20, 10), block_cells=(15, 7))
larger = hhr.FullOrderModel(finer)
out["larger S"] = larger.schur[::20].ravel().tolist()
out["larger norm"] = float(np.linalg.norm(larger.solve([0.2, 50.0]).displacement()))
# what blocks of solutions were written into, once they are let go
places = np.arange(5, dtype=np.int32)
diagonal = factors.Pattern(places, 4 * comm.rank + places[:4], places[:4])
twice = factors.Factors(diagonal, np.full(4, 2.0), "", "mumps", comm)
twice.factor()
blocks = [np.zeros((4, 3), order="F") for _ in range(2)]
twice.solve_block(csc_matrix(np.ones((4, 3))), blocks[0])
twice.multiply(blocks[0], blocks[1])
solved = [float(block.mean()) for block in blocks]
kept_blocks = [weakref.ref(block) for block in blocks]
del blocks
out["left over"] = comm.allgather((solved, [block() is not None for block in kept_blocks]))
# S of a model that has all rows, and a stiffness that varies
out["S"] = np.ravel(pressed.gathered().schur).tolist()
shifting = scale.scene((5, 3), (4, 2), ratios=True)
first = hhr.FullOrderModel(shifting)
second = first.gathered()  # which shares the factors with it
upper, lower = shifting.parameters.upper, shifting.parameters.lower
turns = [("", first, upper), (" gathered", second, lower)]
turns += [(" again", first, upper), (" both", second, lower)]
for name, model, point in turns:
    note("varying" + name, model.solve(point))
# solutions by compressed factors are refined, those of dofs that are eliminated last too
large, sparse.LOW_RANK = sparse.LOW_RANK, ((0, 1e-10),)
compressed = hhr.FullOrderModel(sphere_on_block.scene(sphere_cells=(6, 3), block_cells=(5, 3)))
note("compressed", compressed.solve([0.2, 50.0]))
sparse.LOW_RANK = large
limits.RESPONSE_BYTES, sparse.SOLVED_NUMBERS = kept_bytes, numbers
for name, kind in patch.PAIRINGS.items():
    if "mortar" in name and not present("mortar"):
        continue
    for dim in (2, 3):
        cells = ((4, 3), (7, 3)) if dim == 2 else ((2, 2, 2), (3, 3, 2))
        turned = patch.scene(kind, *cells, poisson=0.3, angle=1.0, bulge=0.04, by_normal=dim == 2)
        model = hhr.FullOrderModel(turned)
        out[f"{{name}} {{dim}} gaps"] = model.problem.gaps[:, 0].tolist()
        out[f"{{name}} {{dim}} rows"] = np.ravel(abs(model.problem.contact).sum(axis=1)).tolist()
        out[f"{{name}} {{dim}} forces"] = model.solve([0.09, 0.03]).forces().tolist()

mixed = patch.scene(pairing, (4, 3), (7, 3), poisson=0.3, angle=1.0, bulge=0.04, by_normal=True)
firm, other = mixed.bodies
mixed = dataclasses.replace(mixed, bodies=(dataclasses.replace(firm, poisson=0.4999), other))
scenes = {{"axisymmetric": pressed_block("axisymmetric", poisson=0.4999), "mixed": mixed,
          "solid": pressed_block("solid", poisson=0.4999, cells=3)}}
out["nearly incompressible"] = {{}}
for name, scene in scenes.items():
    model = hhr.FullOrderModel(scene)
    problem, solution = model.problem, model.solve([0.09, 0.03][: len(scene.parameters.names)])
    dofs = ordered(problem)
    cells = np.lexsort(problem.points[problem.cell_nodes].mean(axis=1).round(9).T)
    whole = problem.gathered(model.comm)
    out["nearly incompressible"] |= {{
        name + " stiffness": whole.stiffness[dofs][:, dofs].toarray().ravel().tolist(),
        name + " displacement": solution.displacement()[dofs].tolist(),
        name + " stress": solution.stress()[cells].ravel().tolist(),
    }}
"""

ELSEWHERE = {
    *("left over", "share of stiffness", "share of mass", "rows", "whole", "said", "kept"),
    "nearly incompressible",
}
"""What has a test of its own."""


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    return numbers_of_ranks(tmp_path_factory.mktemp("snapshots"), PROGRAM)


@needs("nonmatching")
@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks_do_not_change_the_answer(found, ranks):
    assert_same(found[1], found[ranks], ELSEWHERE)


@needs("nonmatching")
@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks_have_the_same_stiffness(found, ranks):
    """Where some have no nearly incompressible cell; round-off times 5000 in the answers."""
    serial, parallel = (found[count]["nearly incompressible"] for count in (1, ranks))
    assert len(serial) == 9 and parallel.keys() == serial.keys()
    for name, value in serial.items():
        tolerance = 1e-14 if "stiffness" in name else 1e-9
        assert np.abs(np.subtract(parallel[name], value)).max() < tolerance * np.abs(value).max(), (
            name
        )


@needs("nonmatching")
@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_no_rank_holds_the_rows_of_another(found, ranks):
    """Entries of all ranks add up to those on one, and none has much more than its part.

    Asked for, all are there.
    """
    mine = found[ranks]
    for name in ("stiffness", "mass"):
        assert mine[f"entries of {name}"] == found[1][f"entries of {name}"] > 2000
        assert (
            sum(mine[f"share of {name}"]) == pytest.approx(1.0)
            and max(mine[f"share of {name}"]) < 1.3 / ranks
        )
    starts, stops, whole = zip(*mine["rows"], strict=True)
    assert starts == (0, *stops[:-1]) and len(starts) == ranks
    assert whole == (ranks == 1,) * ranks
    assert mine["whole"] == [[True, ranks == 1, ranks == 1]] * ranks


@needs("nonmatching")
@pytest.mark.parametrize("ranks", [2, 3])
def test_what_needs_all_rows_says_so_on_every_rank(found, ranks):
    said = found[ranks]["said"]
    assert all(
        text.startswith("ReductionError: displacements of snapshots") for text in said["build"]
    )
    assert all("snapshots.gathered(problem)" in text for text in said["build"])
    assert all(
        text.startswith("SceneError") and "problem.gathered(comm)" in text
        for text in said["stiffness"]
    )
    assert all("give the communicator of its model" in text for text in said["wrong ranks"])
    assert all(texts == ["nothing"] for texts in found[1]["said"].values())


@needs("nonmatching")
@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_what_ranks_share_is_given_back_and_kept(found, ranks):
    """PETSc keeps what several ranks have until all let go of it by name, and with it the array it
    writes into.
    """
    assert found[ranks]["left over"] == [[[0.5, 1.0], [False, False]]] * ranks
    for change, times in found[ranks]["kept"]:
        assert change < 1e-12 and times == 3


LONELY = """
import sys
sys.path[:0] = {folders!r}
import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block
from scenes import block_scene
held, floor = block.side(0, upper=False), hhr.Obstacle(block.side(1, upper=False), (0, -1), 0.0)
clamped = hhr.Displacement.clamp(held, 2)
try:
    hhr.FullOrderModel(block_scene("lonely", {{"a": (0, 1)}}, cells=(2, 1), contacts=(floor,),
                                   displacements=clamped))
except hhr.errors.SceneError as error:
    print(error, flush=True)
"""


def test_a_rank_without_cells_is_told_on_every_rank():
    said = launch(3, ["-c", LONELY.format(folders=SCENE_FOLDERS)])
    assert said.count("1 of 3 ranks have no cell of the mesh: take fewer ranks") == 3


STUDY = """
import dataclasses, sys
sys.path[:0] = {folders!r}
import hertz_half_discs as demo
settings = dataclasses.replace(demo.SETTINGS(), variants=(), models={{}}, queries=5, naive=False)
demo.SETTINGS = lambda: settings
demo.VIEW = lambda: None
demo.main()
"""


def test_a_study_on_two_ranks_is_that_on_one(tmp_path):
    """Ranks share the training, the first one measures.

    Without variants and pictures, which take long.
    """
    program = STUDY.format(folders=SCENE_FOLDERS)
    reports = []
    for ranks in (1, 2):
        launch(ranks, ["-c", program, "--quick", "--out", str(tmp_path / str(ranks))])
        reports.append(json.loads((tmp_path / str(ranks) / "report.json").read_text()))
    assert [report["machine"]["ranks"] for report in reports] == [1, 2]
    # training points start from other statuses: round-off
    assert reports[1]["errors"]["primal_l2"]["max"] == pytest.approx(
        reports[0]["errors"]["primal_l2"]["max"], rel=1e-6
    )


@needs("studies")
def test_a_serial_demo_ends_on_other_ranks():
    """Past the options only the first rank is left, and the others end without an error."""
    program = (
        f"import sys; sys.path[:0] = {SCENE_FOLDERS!r}\n"
        "from parts import cli\n"
        "from mpi4py import MPI\n"
        "options = cli.parse_on_first_rank(cli.demo_parser('serial', 'A serial demo.'))\n"
        "print('rank', MPI.COMM_WORLD.rank, flush=True)\n"
    )
    assert launch(3, ["-c", "import hhr_dolfinx\n" + program]).split() == ["rank", "0"]


FAILING = """
import sys
sys.path[:0] = {folders!r}
import dataclasses
from types import SimpleNamespace
import numpy as np
from mpi4py import MPI
from scenes import pressed_block
import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.ranks import group as ranks
from hhr_dolfinx.errors import ConvergenceError, ParameterError
from hhr_dolfinx.models.answer import ModelFields
from hhr_dolfinx.pairings.obstacle import Obstacle
from hhr_dolfinx.snapshots.records import spread_snapshots
ranks.FAILURE_SECONDS = {patience}
world, last = MPI.COMM_WORLD, MPI.COMM_WORLD.rank == MPI.COMM_WORLD.size - 1
scene = pressed_block("plane_strain")

class Awkward(Exception):
    "An error that can neither be pickled nor made again from its text."
    def __init__(self, first, second):
        super().__init__(first, second)
        self.inner = lambda: None
    def __str__(self):
        return "the disk of this rank is full"

def fail_here(*_, **__):
    if last:
        raise Awkward(1, 2)

def failing_geometry(before):
    def geometry(comm):
        if before:
            fail_here()
        parts = scene.geometry(comm)
        fail_here()
        return parts
    return dataclasses.replace(scene, geometry=geometry)

@dataclasses.dataclass(frozen=True)
class Failing(Obstacle):
    def rows(self, surfaces, dofs):
        fail_here()
        return super().rows(surfaces, dofs)

class FailingStore:
    found = 0
    def load(self, point):
        fail_here()
    def save(self, answer):
        fail_here()

def after(count, what):
    def progress(points):
        for k, point in enumerate(points):
            if k == count:
                what()
            yield point
    return progress

def pairing():
    (floor,) = scene.contacts
    return dataclasses.replace(scene, contacts=(Failing(**vars(floor)),))

def refuse(points, **how):
    raise ParameterError("no answer")

answering = SimpleNamespace(
    rows_at_once=1000,
    parameters=scene.parameters, dimension=2, conditions=0, fields=ModelFields(), solve=refuse,
    solve_many=refuse, columns=lambda many: {{}},
)
{case}
print("rank", world.rank, "went on", flush=True)
"""

TOGETHER = {
    "geometry, at once": "hhr.FullOrderModel(failing_geometry(True))",
    "geometry, after the mesh": "hhr.FullOrderModel(failing_geometry(False))",
    "pairing": "hhr.FullOrderModel(pairing())",
    "snapshots": (
        "hhr.compute_snapshots(hhr.FullOrderModel(scene), scene.parameters.grid([4]), after(2, "
        "fail_here))"
    ),
}
OWN = "hhr.FullOrderModel(scene, MPI.COMM_SELF), scene.parameters.grid([9]), world"
EACH_FOR_ITSELF = {
    "geometry": "hhr.train(failing_geometry(False), [4])",
    "pairing": "hhr.train(pairing(), [4])",
    "snapshot": "hhr.train(scene, [9], progress=lambda label: after(1, fail_here))",
    "store": f"spread_snapshots({OWN}, store=FailingStore())",
}
if present("tables"):
    EACH_FOR_ITSELF["query"] = (
        "hhr.answer_points(answering, np.zeros((9, 1)), world, after(0, fail_here))"
    )


def run_failing(case, ranks, patience=3.0):
    return run_program(
        ranks, ["-c", FAILING.format(folders=SCENE_FOLDERS, case=case, patience=patience)]
    )


@pytest.mark.parametrize("name", [*TOGETHER, "snapshot of its own"])
def test_a_rank_that_fails_ends_the_run(name):
    """In common work the others wait inside of MPI, however long: ended, with the reason, not as if
    all were well.
    """
    case, patience = (
        (TOGETHER[name], 0.2) if name in TOGETHER else (EACH_FOR_ITSELF["snapshot"], 3.0)
    )
    run = run_failing(case, ranks=2, patience=patience)
    assert run.returncode != 0 and "went on" not in run.stdout
    assert (
        "failed on rank 1 of 2" in run.stderr
        and "Awkward: the disk of this rank is full" in run.stderr
    )


CAUGHT = """
def tell(number, action):
    try:
        action()
        mine = (number, world.rank, "nothing", "")
    except Exception as error:
        mine = (number, world.rank, type(error).__name__, str(error))
    told = world.gather(mine)
    if told is not None:
        print(json.dumps(told), flush=True)

def diverge():
    if last:
        raise ConvergenceError("point 7")

import json
"""


def test_every_rank_raises_what_it_can():
    """The error itself where it happened, elsewhere one with rank and text.

    The ranks go on together.
    """
    wrong = (
        "dataclasses.replace(scene, displacements=(hhr.Displacement(99, 0), *scene.displacements))"
    )
    flowing = (
        "dataclasses.replace(scene, bodies=(dataclasses.replace(scene.bodies[0], "
        "law=hhr.Plasticity(1.0)),))"
    )
    careless = "dataclasses.replace(scene, geometry=lambda comm: scene.geometry(world))"
    actions = [
        *EACH_FOR_ITSELF.values(),
        "hhr.train(scene, [9], progress=lambda label: after(1, diverge))",
        f"hhr.FullOrderModel({wrong})",
        f"hhr.train({careless}, [4])",
        "hhr.FullOrderModel(scene).solve(0.05)",
        *([f"hhr.FullOrderModel({flowing})"] if present("inelastic") else []),
    ]
    case = CAUGHT + "".join(f"tell({k}, lambda: {action})\n" for k, action in enumerate(actions))
    # and what one rank alone does with SLEPc keeps no other from its end
    if present("theorems"):
        case += "from hhr_dolfinx.plugins.theorems.full_constants import smallest_singular_value\n"
        case += (
            "if last:\n    alone = hhr.FullOrderModel(scene, MPI.COMM_SELF)\n"
            "    smallest_singular_value(alone.problem.contact)\n"
        )
    run = run_failing(case, ranks=3)
    assert run.returncode == 0 and run.stdout.count("went on") == 3, run.stderr
    # what two ranks print at once may stand on one line
    lines = [line[line.index("[[") :] for line in run.stdout.splitlines() if "[[" in line]
    told = [json.JSONDecoder().raw_decode(line)[0] for line in lines]
    assert [line[0][0] for line in told] == list(range(len(actions)))
    for line in told[: len(EACH_FOR_ITSELF)]:
        kinds, texts = zip(*(words[2:] for words in line), strict=True)
        assert (
            kinds == ("RankError", "RankError", "Awkward")
            and texts[2] == "the disk of this rank is full"
        )
        assert all(
            "failed on rank 2 of 3, Awkward: the disk of this rank is full" in text
            for text in texts[:2]
        )
    diverged, unbuilt, misplaced, *whole = told[len(EACH_FOR_ITSELF) :]
    assert [words[2] for words in diverged] == ["ConvergenceError"] * 3
    assert "rank 2 of 3" in diverged[0][3] and diverged[2][3] == "point 7"
    # wrong on all ranks alike
    assert all(words[2] == "SceneError" and "[99]" in words[3] for words in unbuilt)
    # not blamed on tags that other ranks hold
    for words in misplaced:
        assert words[2] == "SceneError" and "spread over 3 ranks and was requested on 1" in words[3]
        assert "on the communicator it is given" in words[3] and "tags" not in words[3]
    # bodies that flow: each rank has the whole problem, and all share the factors
    assert [words[2] for line in whole for words in line] == ["nothing"] * 3 * len(whole)
