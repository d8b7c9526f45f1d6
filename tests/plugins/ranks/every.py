"""Each command of ``hhr`` and each verb of the API on all ranks of a program, with the numbers that
it gives.

An entry returns numbers, (n,), which are those of one rank to 1e-10, or raises an error of the
package that names ranks. All entries share one small scene and one training.
"""

import csv
import re
import warnings
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import contract
import numpy as np
from click.testing import CliRunner
from mpi4py import MPI
from processes import folders_of
from scenes import pressed_block, pressed_pair

import hhr_dolfinx as hhr
from hhr_dolfinx.command.main import hhr as command
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.files import write_arrays
from hhr_dolfinx.models.starts import KnownStatuses

COMM = MPI.COMM_WORLD
PLAIN = """
import sys
sys.path[:0] = {folders!r}
import hhr_dolfinx as hhr
from every import pair
scene = pair({changes})
"""
PATHS = """
START = {"push": 0.01, "slide": 0.0, "load": 0.05, "gap": 0.005}
DEPTH = hhr.ParameterSpace(("depth",), (0.02,), (0.05,))
LEGS = (hhr.Leg({"push": "depth"}, 1.0, 2),)
PATHS = hhr.PathFamily("pressed", scene.parameters, DEPTH, START, LEGS)
"""
AT = ["--at", "push=0.03,slide=0,load=0.05,gap=0.005"]
BODIES = [(10.0, 0.3), (8.0, 0.3)]
POINT = [0.03, 0.0, 0.05, 0.005]


def pair(**changes):
    """Two blocks with an output."""
    force = hhr.ContactForce("force", 0, (0.0, 1.0))
    return pressed_pair("plane_strain", BODIES, cells=2, outputs=(force,), **changes)


def numbers_of(answer):
    """Forces and the norm of the displacement of an answer."""
    return np.append(answer.forces(), np.linalg.norm(answer.displacement()))


class Work:
    """What entries share: made once, by all ranks."""

    def __init__(self, folder):
        self.folder = Path(folder)

    @cached_property
    def scene(self):
        return self.file_of("scene.py", PLAIN.format(folders=folders_of(__file__), changes=""))

    @cached_property
    def scene_with_paths(self):
        return self.file_of(
            "paths.py", PLAIN.format(folders=folders_of(__file__), changes="") + PATHS
        )

    @cached_property
    def scene_of_a_deck(self):
        """A deck has no gaps that are added."""
        return self.file_of(
            "deck.py", PLAIN.format(folders=folders_of(__file__), changes="openings=()")
        )

    def file_of(self, name, text):
        path = self.folder / name
        if COMM.rank == 0:
            path.write_text(text)
        COMM.barrier()
        return path

    @cached_property
    def full(self):
        return hhr.FullOrderModel(pair())

    @cached_property
    def training(self):
        return hhr.train(pair(), hhr.Sobol(12), held_out=4)

    @cached_property
    def together(self):
        return hhr.train(pair(), hhr.Sobol(12), held_out=4, together=True)

    @cached_property
    def points(self):
        return self.full.parameters.random(5, 3)

    @cached_property
    def model(self):
        return self.training.condense()

    def solved(self, model):
        return np.concatenate(
            [numbers_of(model.solve(point, outside="ignore")) for point in self.points]
        )

    @cached_property
    def file(self):
        path = self.folder / "condensed.npz"
        model = self.model
        if COMM.rank == 0:
            hhr.save_model(path, model)
        COMM.barrier()
        return path

    @cached_property
    def table(self):
        path = self.folder / "points.csv"
        rows = [self.full.parameters.names, *self.points.tolist()]
        if COMM.rank == 0:
            with open(path, "w", newline="") as file:
                csv.writer(file).writerows(rows)
        COMM.barrier()
        return path


def first(numbers):
    """Numbers that the first rank alone has, on all."""
    return COMM.bcast(None if numbers is None else np.asarray(numbers, dtype=float))


def fields(work):
    hhr.write_fields(work.folder / "answer.vtu", work.full, work.full.solve(POINT))
    return [1.0]


def heated(work):
    """Each rank makes the model of its own, and keeps it in a file of its own."""
    blocks = contract.blocks()
    scene = replace(blocks, outputs=())
    tags = [body.tag for body in scene.bodies]
    ends = [displacement.tag for displacement in scene.displacements]
    heat = hhr.Heat(
        conductivity=dict.fromkeys(tags, 2.0),
        conductance={0: "1 + p"},
        expansion=dict.fromkeys(tags, 1e-3),
        temperatures=[hhr.FixedTemperature(ends[0], 0.0), hhr.FixedTemperature(ends[-1], 20.0)],
    )
    path = work.folder / f"heat{COMM.rank}.npz"
    hhr.save_heat_model(path, hhr.condense_heat(scene, heat))
    in_time = hhr.condense_transient_heat(
        scene, replace(heat, capacity=dict.fromkeys(tags, 1.0)), tolerance=0.01
    )
    warm = in_time.march(contract.MIDDLE, [0.1, 0.3], start=5.0)[-1]
    return np.concatenate([hhr.load_heat_model(path).solve(contract.MIDDLE).heat, warm.heat])


def answered_table(work):
    from hhr_dolfinx.command.console import make_console

    rows = hhr.read_points(work.table, work.model.parameters)
    bad = hhr.answer_table(work.model, rows, work.folder / "answered.csv", make_console(quiet=True))
    return [bad, *csv_numbers(work.folder / "answered.csv")]


def csv_numbers(path):
    """All numbers of a table of answers."""
    COMM.barrier()
    with open(path, newline="") as file:
        cells = [cell for row in list(csv.reader(file))[1:] for cell in row]
    return [float(cell) for cell in cells if re.fullmatch(r"[-+.\de]+", cell)]


def page(work):
    hhr.write_model_page(
        work.folder / "page.html",
        work.model,
        hhr.scenery_of(hhr.FullOrderModel(pair(), MPI.COMM_SELF)),
    )
    return [len((work.folder / "page.html").read_text()) > 1000]


def statuses(work):
    return KnownStatuses(
        work.full.problem.middle[None], np.zeros((1, work.full.conditions), dtype=bool)
    )


def of_matrices(work):
    """A model of matrices: one dof on a spring, which contact stops."""
    space = hhr.ParameterSpace(("f",), (0.0,), (2.0,))
    model = hhr.condense_matrices(space, [[2.0]], [[1.0]], [[1.0, 0.0]], [[0.0, 0.5]], ["f", 1.0])
    return model.solve(2.0).forces()


def of_blocks(work):
    """K of a block, that of its bodies; also of the file of another code."""
    (block,) = hhr.blocks_of_scene(pressed_block("solid", cells=2))
    matrix = block.stiffness.matrix.tocoo()
    path = work.folder / f"k{COMM.rank}.npz"
    named = {"nodes": block.stiffness.nodes, "directions": block.stiffness.directions}
    np.savez(path, row=matrix.row, col=matrix.col, data=matrix.data, **named)
    return [abs(matrix).sum(), abs(hhr.read_stiffness(path).matrix).sum()]


def study(work):
    settings = hhr.StudySettings(training=hhr.Sobol(12), held_out=4, tests=6, queries=6)
    found = hhr.study_scene(pair(), settings, work.folder / "study")
    return [COMM.bcast(found is not None)]


def written(work):
    answers = hhr.answer_points(work.model, work.points, COMM)
    if COMM.rank == 0:
        hhr.write_answers(work.folder / "written.csv", work.model.parameters, answers)
    return csv_numbers(work.folder / "written.csv")


METHODS = {
    "solve": lambda work: numbers_of(work.full.solve(POINT)),
    "solve with a gradient": lambda work: work.full.solve(
        POINT, gradient=True
    ).gradient.multipliers.ravel(),
    "solve_many": lambda work: np.concatenate(
        [numbers_of(one) for one in work.full.solve_many(work.points)]
    ),
    "march": lambda work: numbers_of(
        work.full.march([(0.0, work.points[0]), (1.0, POINT)]).answers[-1]
    ),
    "outputs": lambda work: list(work.full.outputs(POINT).values.values()),
    "stress": lambda work: [np.linalg.norm(work.full.solve(POINT).stress())],
    "pressure": lambda work: work.full.solve(POINT).pressure(),
    "coupling": lambda work: [work.full.coupling(POINT)],
    "gathered": lambda work: work.solved(work.full.gathered()),
    "plot": lambda work: [work.full.solve(POINT).plot() is not None],
}
"""Methods of a full model that all ranks have together, and of its answers."""
KINDS = {
    "build": lambda work: [np.linalg.norm(work.solved(work.training.build()))],
    "build together": lambda work: work.solved(
        work.together.build(hhr.Recipe(hhr.Pod(1e-13), trust=None))
    ),
    "condense": lambda work: work.solved(work.training.condense()),
    "condense together": lambda work: work.solved(work.together.condense()),
    "local": lambda work: [np.linalg.norm(work.solved(work.training.local()))],
    "safe_model": lambda work: work.solved(work.training.safe_model(1e-12)),
}
"""Methods of a training."""
FUNCTIONS = {
    "answer_points": lambda work: first(
        getattr(hhr.answer_points(work.model, work.points, COMM), "forces", None)
    ),
    "answer_table": answered_table,
    "blocks_of_scene": of_blocks,
    "build": lambda work: work.solved(hhr.build(work.together.full_order, work.together.snapshots)),
    "compute_snapshots": lambda work: hhr.compute_snapshots(work.full, work.points).forces,
    "condense": lambda work: work.solved(hhr.condense(pair())),
    "condense_matrices": of_matrices,
    "exact_condensation": lambda work: work.solved(
        hhr.exact_condensation(work.full, statuses(work))
    ),
    "load_model": lambda work: work.solved(hhr.load_model(work.file)),
    "mesh_error": lambda work: [hhr.mesh_error(work.full, work.full.solve(POINT)).energy],
    "read_points": lambda work: [
        float(cell)
        for row in hhr.read_points(work.table, work.full.parameters)
        for cell in row.cells
    ],
    "reduce": lambda work: work.solved(hhr.reduce(pair(), 0.01)),
    "save_model": lambda work: [work.file.stat().st_size > 0],
    "drive": lambda work: (
        hhr.FullOrderModel(
            hhr.drive(pressed_block("plane_strain"), 0, at=(0.5, 0.0), motion={1: "push / 10"}),
            COMM,
        )
        .solve({"push": 0.05})
        .forces()
    ),
    "slide": lambda work: (
        hhr.slide(pressed_pair("plane_strain", BODIES, cells=2, matching=False, openings=()))
        .solve({"push": 0.03, "slide": 0.0, "load": 0.05, "gap": 0.005})
        .forces()
    ),
    "spread_snapshots": lambda work: (
        hhr.spread_snapshots(work.training.full_order, work.points, COMM).forces
    ),
    "study_scene": study,
    "to_pandas": lambda work: (
        hhr.to_pandas(work.model, work.points, outside="ignore").select_dtypes("number").to_numpy()
    ),
    "to_xarray": lambda work: hhr.to_xarray(work.model, work.points, outside="ignore")[
        "forces"
    ].to_numpy(),
    "train": lambda work: work.training.snapshots.forces,
    "write_answers": written,
    "write_fields": fields,
    "write_model_page": page,
    "condense_heat": heated,
    "with_surface_fields": lambda work: work.solved(hhr.with_surface_fields(work.model)),
    "worst": lambda work: [hhr.worst(work.model, "force").proven],
    "score_submission": lambda work: list(hhr.score_submission(*submitted(work))["block"].values()),
}
"""Functions of the package by name."""
CALLED = {
    "check_certificate": "worst",
    "condense_transient_heat": "condense_heat",
    "load_heat_model": "condense_heat",
    "save_heat_model": "condense_heat",
    "read_stiffness": "blocks_of_scene",
    "run_study": "study_scene",
    "scenery_of": "write_model_page",
}
"""Functions that another one calls here."""


def invoked(*words):
    """Output of a command on this rank, which must end well."""
    result = CliRunner().invoke(command, [str(word) for word in words], prog_name="hhr")
    if result.exit_code or result.exception is not None:
        raise CommandError(
            f"exit code {result.exit_code}: {result.output[-1000:]} {result.exception!r}"
        )
    return first_words(result.stdout)


class CommandError(HHRError):
    """A command that has not ended well."""


def first_words(output):
    """Output of the first rank; others must print nothing, so that nothing stands there twice."""
    every = COMM.allgather(output)
    assert not any(every[1:]), every
    return every[0]


def told(output):
    """Numbers of an output."""
    return [
        float(word)
        for word in re.findall(r"(?<![\w.])[-+]?\d+\.?\d*(?:e[-+]?\d+)?(?![\w.])", output)
    ]


def trained(work):
    invoked("train", work.scene, "--sobol", 12, "--out", work.folder / "trained")
    return [np.linalg.norm(work.solved(hhr.load_model(work.folder / "trained" / "hhr.npz")))]


def trained_together(work):
    folder = work.folder / "together"
    invoked(
        "train", work.scene, "--sobol", 12, "--out", folder, "--model", "condensed", "--together"
    )
    model = hhr.load_model(folder / "condensed.npz")
    return np.concatenate([model.solve(point, outside="ignore").forces() for point in work.points])


def reduced(work):
    invoked("reduce", work.scene, "--out", work.folder / "reduced")
    return work.solved(hhr.load_model(work.folder / "reduced" / "model.npz"))


def answered(work):
    invoked("answer", work.file, work.table, "--out", work.folder / "answers.csv")
    return csv_numbers(work.folder / "answers.csv")


def written_by(name, ending, *words):
    """Entry of a command that writes a file: the numbers of its text."""

    def run(work):
        path = work.folder / f"{name}{ending}"
        invoked(
            name, work.file if name != "export" else work.scene_of_a_deck, *words, "--out", path
        )
        return told(path.read_text())

    return run


def started(work):
    deck = work.folder / "export.inp"
    invoked("export", work.scene_of_a_deck, *AT, "--out", deck)
    invoked("start", deck, "--to", work.folder / "started.py", "--force")
    return [(work.folder / "started.py").stat().st_size > 0]


def studied(work):
    folder = work.folder / "studied"
    invoked("study", work.scene, "--sobol", 12, "--tests", 6, "--queries", 6, "--out", folder)
    return [(folder / "report.json").stat().st_size > 0]


def reported(work):
    studied(work)
    invoked("report", work.folder / "studied")
    return [(work.folder / "studied" / "report.html").stat().st_size > 0]


def certified(work):
    """A proof, and its claim proven again: the words of the second command."""
    proof = work.folder / "proof.npz"
    invoked("worst", work.file, "force", "--certificate", proof)
    COMM.barrier()
    return told(invoked("certificate", proof))


def submitted(work):
    """A submission to a data set and hidden answers, written by the first rank."""
    from hhr_dolfinx.plugins.bench.score import ANSWERS_FORMAT, ANSWERS_VERSION

    answers, file = work.folder / "hidden", work.folder / "mine.npz"
    if COMM.rank == 0:
        answers.mkdir(exist_ok=True)
        header = {"format": ANSWERS_FORMAT, "version": ANSWERS_VERSION}
        exact = {"forces": np.array([[3.0, 4.0]]), "floor": np.array(0.1)}
        write_arrays(answers / "block.npz", header, exact)
        np.savez(file, **{"block/forces": np.array([[3.0, 4.5]])})
    COMM.barrier()
    return file, answers


def scored(work):
    """The words of the command."""
    file, answers = submitted(work)
    return told(invoked("bench", "score", file, "--answers", answers))


COMMANDS = {
    "answer": answered,
    "bench score": scored,
    "certificate": certified,
    "check": lambda work: [
        len(invoked("check", work.scene, "--picture", work.folder / "check.png")) > 0
    ],
    "embed": written_by("embed", ".h"),
    "export": written_by("export", ".inp", *AT),
    "list": lambda work: [len(invoked("list"))],
    "march": lambda work: told(invoked("march", work.scene_with_paths, "--at", "depth=0.03")),
    "page": lambda work: [
        len(invoked("page", work.file, "--scene", work.scene, "--out", work.folder / "p.html")) > 0
    ],
    "reduce": reduced,
    "report": reported,
    "serve": lambda work: (
        [1.0] if COMM.size == 1 else [len(invoked("serve", work.file, "--port", 0))]
    ),
    "solve": lambda work: told(invoked("solve", work.scene, *AT)),
    "start": started,
    "study": studied,
    "train": trained,
    "train --together": trained_together,
    "worst": lambda work: told(invoked("worst", work.file, "force").partition("\nwork:")[0]),
}
"""Commands by name."""
ENTRIES = {
    **{f"hhr {name}": entry for name, entry in COMMANDS.items()},
    **{f"full.{name}": entry for name, entry in METHODS.items()},
    **{f"training.{name}": entry for name, entry in KINDS.items()},
    **{f"hhr.{name}": entry for name, entry in FUNCTIONS.items()},
}


def outcomes(names, folder):
    """Numbers of entries, or an error of the package in words, on each rank."""
    warnings.simplefilter("ignore")
    work = Work(folder)
    found = {}
    for name in names:
        try:
            own = np.ravel(np.asarray(ENTRIES[name](work), dtype=float)).tolist()
        except HHRError as error:
            own = f"{type(error).__name__}: {error}"
        found[name] = COMM.allgather(own)
    return found
