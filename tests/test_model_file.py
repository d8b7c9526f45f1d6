"""Models on disk: what is read is what was written, and nothing else is read."""

import dataclasses
import json
import subprocess
import sys
from dataclasses import dataclass, fields, replace

import flowing
import numpy as np
import pellet_cladding
import pellet_cladding_plastic as plastic_demo
import pytest
from bare import WAIT, rewrite_signed
from parted import by_lapack
from scenes import largest_difference, pressed_block
from toy_law import Bingham
from toy_nonaffine_load import Square, WindLoad

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileContentError, FileError, HHRError, ModelFileError, ModelFileWarning
from hhr_dolfinx.geometries import block
from hhr_dolfinx.linear.dense import LapackLU
from hhr_dolfinx.materials.update import Material
from hhr_dolfinx.models.cubature_flow import CubatureFlow
from hhr_dolfinx.models.estimates import Estimate
from hhr_dolfinx.models.floating_bound import FloatingBound
from hhr_dolfinx.models.output_bound import OutputBound
from hhr_dolfinx.models.reconstruct import GappyField
from hhr_dolfinx.online import layout


@pytest.fixture
def path(hertz_reduction, tmp_path):
    hhr.save_model(tmp_path / "model.npz", hertz_reduction)
    return tmp_path / "model.npz"


def bits(answer):
    """What an answer hands out, which must not change in its last digits."""
    parts = answer.unknown, answer.multipliers, answer.displacement(), answer.forces(), answer.plastic_strain()
    return *parts, *(() if answer.gauss is None else (answer.stress(),))


def test_round_trip(path, hertz_reduction):
    """To the last bit where the same library factors; PETSc's blocks differ by round-off, 1e-15 of the largest seen."""
    stored, lapack = hhr.load_model(path), by_lapack(hertz_reduction)
    for mu in (0.168, 0.4321):
        mine, theirs, built = (model.solve(mu) for model in (stored, lapack, hertz_reduction))
        assert all(map(np.array_equal, bits(mine), bits(theirs)))
        assert largest_difference(mine.forces(), built.forces()) < 1e-12
        assert largest_difference(mine.displacement(), built.displacement()) < 1e-12


def test_answers_without_dolfinx_gmsh_and_plots(path, hertz_reduction):
    """The online side is light: another process answers and has loaded none of the offline side."""
    program = (
        "import sys, hhr_dolfinx as hhr\n"
        f"print(hhr.load_model({str(path)!r}).solve(0.3).forces().tolist())\n"
        "heavy = {'dolfinx', 'ufl', 'gmsh', 'pyvista', 'matplotlib', 'slepc4py', 'petsc4py', 'mpi4py'}\n"
        "heavy &= set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert json.loads(run.stdout) == by_lapack(hertz_reduction).solve(0.3).forces().tolist()


def test_an_old_file_survives_a_failed_write(path, hertz_reduction, monkeypatch):
    before = path.read_bytes()
    monkeypatch.setattr(np, "savez", lambda *_, **__: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(FileError, match=r"model\.npz cannot be written \(disk full\)"):
        hhr.save_model(path, hertz_reduction)
    assert path.read_bytes() == before and len(list(path.parent.iterdir())) == 1


def rewrite(path, change):
    with np.load(path) as file:
        arrays = dict(file)
    change(arrays)
    with open(path, "wb") as file:
        np.savez(file, **arrays)


def test_a_changed_number_is_found(path):
    rewrite(path, lambda arrays: arrays["reduced.stiffness"].__setitem__((0, 0), 1.0))
    with pytest.raises(ModelFileError, match="checksum"):
        hhr.load_model(path)


def test_a_changed_box_is_found(path):
    def widen(arrays):
        header = json.loads(str(arrays["header"]))
        header["parameters"]["upper"] = [9.0]
        arrays["header"] = np.array(json.dumps(header))

    rewrite(path, widen)
    with pytest.raises(ModelFileError, match="checksum"):
        hhr.load_model(path)


def test_another_version_is_named(path):
    def age(arrays):
        header = json.loads(str(arrays["header"])) | {"version": 99}
        arrays["header"] = np.array(json.dumps(header))

    rewrite(path, age)
    with pytest.raises(ModelFileError, match="version 99"):
        hhr.load_model(path)


@pytest.mark.parametrize(
    "damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b"not a model", lambda b: b[:-40]]
)
def test_a_damaged_file_is_refused(path, damage):
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(ModelFileError, match="damaged"):
        hhr.load_model(path)


def test_pickles_are_not_read(path):
    rewrite(path, lambda arrays: arrays.__setitem__("reduced.loads", np.array([{}], dtype=object)))
    with pytest.raises(ModelFileError, match="damaged"):
        hhr.load_model(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ModelFileError, match="no model file"):
        hhr.load_model(tmp_path / "nothing.npz")


def test_a_folder_or_a_pipe_is_no_model(tmp_path):
    with pytest.raises(ModelFileError, match="no regular file"):
        hhr.load_model(tmp_path)


@pytest.fixture(scope="module")
def pellet_reduction():
    """A model with a pressure on a part of a line: 42 terms, of which 41 move no imposed dof."""
    full_order = hhr.FullOrderModel(pellet_cladding.scene(**pellet_cladding.QUICK_MESH))
    points = full_order.parameters.grid([8, 8])
    return hhr.build(full_order, hhr.compute_snapshots(full_order, points))


@pytest.fixture
def pellet_path(pellet_reduction, tmp_path):
    hhr.save_model(str(tmp_path / "pellet.npz"), pellet_reduction)
    return tmp_path / "pellet.npz"


@pytest.fixture(scope="module")
def flowing_reduction():
    return flowing.flowing_reduction(flowing.flowing_full())


@pytest.fixture
def flowing_path(flowing_reduction, tmp_path):
    hhr.save_model(tmp_path / "flowing.npz", flowing_reduction)
    return tmp_path / "flowing.npz"


def test_a_partial_pressure_comes_back_to_the_last_bit(pellet_path, pellet_reduction):
    stored, lapack = hhr.load_model(str(pellet_path)), by_lapack(pellet_reduction)
    for mu in ((170.0, 3.2), (5.0, 0.6)):
        for mine, theirs in zip(bits(stored.solve(mu)), bits(lapack.solve(mu)), strict=True):
            assert mine.tobytes() == theirs.tobytes()
    assert stored.fields.amplitudes.firsts == pellet_reduction.fields.amplitudes.firsts


def dense(value):
    return value.toarray() if hasattr(value, "toarray") else value


def check_alike(mine, theirs, but=()):
    """Every array of two values, parts of parts too, in its last digits and in its order in memory."""
    names = theirs._fields if hasattr(theirs, "_fields") else [item.name for item in fields(theirs)]
    for name in set(names) - set(but):
        one, two = getattr(mine, name), getattr(theirs, name)
        if hasattr(two, "_fields") or hasattr(two, "__dataclass_fields__"):
            check_alike(one, two)
        elif hasattr(two, "groups"):
            assert len(one.groups) == len(two.groups)
            for pair in zip(one.groups, two.groups, strict=True):
                check_alike(*pair)
        elif isinstance(dense(two), np.ndarray):
            # packed matrices lose the sign of their zeros
            assert type(one) is type(two) and (dense(one) + 0.0).tobytes() == (dense(two) + 0.0).tobytes(), name
            assert not (isinstance(two, np.ndarray) and two.size) or one.strides == two.strides, name
        elif name != "nonaffine":
            assert one == two, name


def test_every_array_comes_back(pellet_path, pellet_reduction, flowing_path, flowing_reduction):
    for path, model in ((pellet_path, pellet_reduction), (flowing_path, flowing_reduction)):
        stored = hhr.load_model(path)
        check_alike(stored.problem, model.problem)
        check_alike(stored.fields, model.fields, but=("stress_of",))
        check_alike(stored.trained, model.trained)
        check_alike(stored.parameters, model.parameters)
        for part in ("known", "flow"):
            if getattr(model, part) is None:
                assert getattr(stored, part) is None
            else:
                check_alike(getattr(stored, part), getattr(model, part))
        assert stored.offline is None


def test_zeros_are_not_stored(pellet_path, pellet_reduction):
    """Of the (N, 1 + T) lifts no entry is not zero: the basis is the largest array."""
    with np.load(pellet_path) as file:
        sizes = {name: file[name].nbytes for name in file.files}
    assert max(sizes, key=sizes.get) == "fields.basis"
    assert sum(size for name, size in sizes.items() if "lifts" in name) < 1000
    # of the gaps of 42 terms only one column is not zero: 24 bytes for each condition
    conditions = len(pellet_reduction.fields.gaps)
    assert sum(size for name, size in sizes.items() if "fields.gaps" in name) <= 24 * conditions


def test_more_than_ten_partial_pressures_keep_their_order(pellet_reduction, tmp_path):
    """Named by numbers, amplitudes10 comes behind amplitudes9, not behind amplitudes1."""
    model = pellet_reduction
    line = model.fields.amplitudes.nonaffine[0]
    lines = tuple(replace(line, positions=line.positions[:2], constant=float(k)) for k in range(12))
    amplitudes = replace(model.fields.amplitudes, nonaffine=lines)

    def cut(part, **changed):
        """As many terms as twelve lines of two nodes have; no answer is asked for."""
        wide = {name: getattr(part, name) for name in ("loads", "gaps", "lifts") if hasattr(part, name)}
        return replace(part, **{name: array[:, :37] for name, array in wide.items()}, **changed)

    forces = np.ones((len(model.fields.gaps), 1))  # without a bound something has to complete forces
    modes = {"basis": np.ones((len(model.fields.basis), len(model.problem.stiffness)))}
    modes |= {"contact_basis": np.ones((len(forces), len(model.problem.stiffness))), "response": None}
    fields = cut(model.fields, amplitudes=amplitudes, bound=None, force_snapshots=forces, **modes)
    changed = hhr.ReducedModel(cut(model.problem), model.parameters, fields, known=model.known)
    hhr.save_model(tmp_path / "lines.npz", changed)
    stored = hhr.load_model(tmp_path / "lines.npz")
    assert [coverage.constant for coverage in stored.fields.amplitudes.nonaffine] == [float(k) for k in range(12)]
    assert stored.trained is None  # as it was saved


def test_the_table_has_a_line_for_every_field(pellet_reduction, flowing_reduction):
    """A field that is added to a part of a model must not be forgotten in its file."""
    flow, trained = flowing_reduction.flow, flowing_reduction.trained
    parts = {
        "reduced": pellet_reduction.problem,
        "fields": pellet_reduction.fields,
        "amplitudes": pellet_reduction.fields.amplitudes,
        "bound": pellet_reduction.fields.bound,
        "response": pellet_reduction.fields.response,
        "output_bound": OutputBound,
        "known": pellet_reduction.known,
        "trained": trained.parameters,
        "paths": trained,
        "flow": flow,
    }
    names = {f"{part}.{item.name}" for part, value in parts.items() for item in fields(value)}
    names |= {f"flow.{item.name}" for item in fields(flow.operator)}
    names |= {f"cubature.{item.name}" for item in fields(CubatureFlow)}
    names |= {f"{part}.{item.name}" for part in ("flow", "cubature") for item in fields(flow.material.groups[0])}
    names |= {f"bound.{item.name}" for item in fields(FloatingBound)}
    named = {name.removesuffix(".rows") for name in layout.LAYOUT if not name.endswith((".columns", ".values"))}
    # what is written in other ways: values as a kind and numbers, sizes, names of parameters, points by their group
    others = {"amplitudes.nonaffine", "flow.law", "flow.size", "fields.dimension", "trained.names", "paths.parameters"}
    others |= {"flow.operator", "flow.material", "flow.indices", "fields.amplitudes", "fields.flow", "fields.bound"}
    others |= {"fields.output_bound", "fields.unbounded", "fields.response"}
    others |= {"cubature.material", "cubature.indices", "cubature.law"}
    # the parts of a stiffness that varies are a tree of their own
    left_behind = {"fields.stress_of", "fields.indicator", "reduced.terms", "reduced.reshaped", "fields.functionals"}
    left_behind.add("fields.reshaped_contact")
    assert names - named == others | left_behind
    parts = [item.name for item in fields(GappyField)]
    completion = {f"completion.{field}_{part}" for field in ("stress", "cumulated") for part in parts}
    assert named - names == completion | {"flow.group", "cubature.group"}
    assert set(layout.INDICES) <= set(layout.LAYOUT)


def entry(name, index, value):
    return lambda header, arrays: arrays[name].__setitem__(index, value)


def array(name, change):
    return lambda header, arrays: arrays.update({name: np.asarray(change(arrays[name]))})


def header(**values):
    return lambda header, arrays: header.update(values)


def box(**values):
    return lambda header, arrays: header["parameters"].update(values)


def number(what, **values):
    return lambda header, arrays: header[what][0]["numbers"].update(values)


TOY = {"kind": "Toy", "numbers": {}}


SIGNED = {
    "basis.* is not finite": entry("fields.basis", (0, 0), np.nan),
    "known.points.* is not finite": entry("known.points", (0, 0), np.inf),
    "basis has type int32": array("fields.basis", lambda a: a.astype(np.int32)),
    "basis.npy is no plain array": array("fields.basis", lambda a: a.astype(np.float32)),
    "active has type float64": array("known.active", lambda a: a.astype(float)),
    "A_lambda has type float64": array("fields.A_lambda", lambda a: a.astype(float)),
    "contact_test has shape": array("reduced.contact_test", lambda a: a[:, :-1]),
    "contact_trial has shape": array("reduced.contact_trial", lambda a: a[:-1]),
    "loads has shape": array("reduced.loads", lambda a: a[:, 0]),
    "basis has shape": array("fields.basis", lambda a: a.T),
    "slopes has shape": array("amplitudes.slopes", lambda a: a[:, :1]),
    "active has shape": array("known.active", lambda a: a[:, :-1]),
    "gap_scale has shape": array("fields.gap_scale", lambda a: a[None]),
    "gap_scale has the entry 0.0": array("fields.gap_scale", lambda a: 0.0 * a),
    "A_lambda has indices outside": entry("fields.A_lambda", 0, 10**6),
    "A_lambda has indices outside 0": entry("fields.A_lambda", 0, -1),
    "fields.gaps.columns has indices outside 0": entry("fields.gaps.columns", 0, 42),
    "reduced.gaps.rows has indices outside 0": entry("reduced.gaps.rows", 0, -1),
    "values has shape": array("fields.gaps.values", lambda a: a[:-1]),
    "are dependent": entry("fields.A_lambda", 0, 1),
    "singular": entry("reduced.stiffness", slice(None), 0.0),
    "first amplitude must be": entry("amplitudes.constant", 0, 2.0),
    "extends up to parameter 9": number("amplitudes", extent=9),
    "extends up to parameter -1": number("amplitudes", extent=-1),
    "extent of Coverage is 0.5": number("amplitudes", extent=0.5),
    "has slopes along 1": array("amplitudes0.slopes", lambda a: a[:1]),
    "must return columns": array("amplitudes0.slopes", lambda a: np.append(a, 1.0)),
    "positions .* must .* increase": array("amplitudes0.positions", lambda a: a[::-1].copy()),
    "the amplitudes are 1": array("amplitudes0.positions", lambda a: a[:-1]),
    "a Coverage has the fields": lambda header, arrays: arrays.pop("amplitudes0.slopes"),
    "must have a kind and numbers": header(amplitudes=[None]),
    "amplitudes, laws, outputs in its header must be lists": header(laws={}),
    "laws of flow, and nothing flows": header(laws=[None]),
    "amplitude Toy.* must be an Amplitude": lambda header, arrays: header["amplitudes"].append(TOY),
    "trained range ends below": array("trained.upper", lambda a: a - 1e6),
    "dofs are no nodes": lambda header, arrays: arrays.update(
        {name: arrays[name][:-1] for name in ("fields.basis", "response.loaded")}
    ),
    "columns of its displacement .* are not those": lambda header, arrays: arrays.update(
        {name: arrays[name][:, :-1] for name in ("fields.basis", "fields.contact_basis")}
    ),
    "nothing completes them": lambda header, arrays: [
        arrays.pop(name) for name in list(arrays) if name.startswith("bound.")
    ],
    "bound.schur has shape": array("bound.schur", lambda a: a[:-1]),
    "neither training forces nor a bound": lambda header, arrays: (
        [arrays.pop(name) for name in list(arrays) if name.startswith(("bound.", "response."))],
        arrays.update(
            {
                name: np.zeros((len(arrays[name]), len(arrays["reduced.stiffness"])))
                for name in ("fields.basis", "fields.contact_basis")
            }
        ),
    ),
    "sizes .* are zero": lambda header, arrays: arrays.update(
        {name: arrays[name][:0] for name in list(arrays) if name.startswith("known.")}
    ),
    r"\['known.points'\] are missing": lambda header, arrays: arrays.pop("known.points"),
    r"\['known.more'\] are unknown": lambda header, arrays: arrays.update({"known.more": np.zeros(1)}),
    r"\['amplitudes1.more'\] are unknown": lambda header, arrays: arrays.update({"amplitudes1.more": np.zeros(1)}),
    "dimension must be 2 or 3, not 'two'": header(dimension="two"),
    "dimension must be 2 or 3, not 2.0": header(dimension=2.0),
    "dimension must be 2 or 3, not 4": header(dimension=4),
    "its header has the keys": header(more=1),
    "the parameters must have": header(parameters=[1, 2]),
    r"names = \[1, 2\] .* must hold names": box(names=[1, 2]),
    "names = 'ab' .* must be a tuple": box(names="ab"),
    r"lower = \[None, 1.0\] .* must hold numbers": box(lower=[None, 1.0]),
    "named twice": box(names=["h1", "h1"]),
    "must be increasing": box(upper=[0.0, 0.0]),
    "need one lower and one upper": box(upper=[1.0]),
    "slopes has shape .* P = 3": box(names=["a", "b", "c"], lower=[0.0] * 3, upper=[1.0] * 3),
}

SIGNED_FLOWING = {
    "flow.dofs has indices outside": entry("flow.dofs", (0, 0), 10**6),
    "flow.dofs has indices outside 0": entry("flow.dofs", (0, 0), -1),
    "flow.inner has indices outside": entry("flow.inner", 0, 10**6),
    "flow.cells has indices outside": entry("flow.cells", 0, 10**6),
    "flow.group has indices outside": entry("flow.group", (0, 0), 2),
    "flow.loads.columns has indices outside": entry("flow.loads.columns", 0, 10**6),
    "flow.contact.rows has indices outside": entry("flow.contact.rows", 0, 10**6),
    "components has|4 components in dimension 3": header(dimension=3),
    "weights has shape": array("flow.weights", lambda a: a[:, :-1]),
    "gradients has shape": array("flow.gradients", lambda a: a[..., 0]),
    "modes has shape": array("flow.modes", lambda a: a[:, :-1]),
    "points are not cells times per cell": array("completion.cumulated_fit", lambda a: a[:, :-1]),
    "stress inside are not cells": array("completion.stress_fit", lambda a: a[:, :-1]),
    "stress values are not gauss points": array("completion.stress_modes", lambda a: a[:-1]),
    "gauss points are not all cells": lambda header, arrays: arrays.update(
        {
            "completion.cumulated_modes": arrays["completion.cumulated_modes"][:-1],
            "completion.stress_modes": arrays["completion.stress_modes"][:-4],
        }
    ),
    "544 stress values are": array("completion.cumulated_modes", lambda a: a[:-1]),
    "Young's moduli": entry("flow.young", 0, -1.0),
    "Poisson's ratios": entry("flow.poisson", 0, 0.5),
    "poisson has shape": array("flow.poisson", lambda a: a[:1]),
    "a Gauss point has the weight": entry("flow.weights", (0, 0), 0.0),
    "flow.inner has a number twice": array("flow.inner", np.zeros_like),
    "trained steps take": array("paths.steps", lambda a: np.array([2.0, 1.0])),
    "1 laws for 2 groups": lambda header, arrays: header["laws"].pop(),
    "each must have a flow": lambda header, arrays: header["laws"].__setitem__(1, TOY),
    "Plasticity refuses": number("laws", yield_stress=-1.0),
    "imbalance has shape": array("paths.imbalance", lambda a: a[None]),
    "steps has shape": array("paths.steps", lambda a: np.append(a, 1.0)),
    r"'paths.imbalance'.* are missing": lambda header, arrays: arrays.pop("paths.imbalance"),
    r"'paths.estimate'.* are missing": lambda header, arrays: arrays.pop("paths.estimate"),
    r"'flow.cells'.* are missing": lambda header, arrays: arrays.pop("flow.cells"),
}


@dataclass(frozen=True)
class Toy:
    """A value that is no law."""


def check_refused(path, why, change):
    rewrite_signed(path, change)
    with pytest.raises(ModelFileError, match=f"{why}.*build the model again"):
        hhr.load_model(path, known=[Toy])


@pytest.mark.parametrize("why", SIGNED)
def test_a_signed_file_of_other_content_is_refused_where_it_is_read(why, pellet_path):
    check_refused(pellet_path, why, SIGNED[why])


@pytest.mark.parametrize("why", SIGNED_FLOWING)
def test_a_signed_file_of_bodies_that_flow_too(why, flowing_path):
    check_refused(flowing_path, f"({why})", SIGNED_FLOWING[why])


def test_signed_files_that_were_not_changed_are_read(pellet_path, flowing_path):
    """Else the tests above would pass with a wrong signature."""
    for path in (pellet_path, flowing_path):
        rewrite_signed(path, lambda header, arrays: None)
        hhr.load_model(path)


def test_indices_of_four_bytes_are_widened(flowing_path, flowing_reduction):
    """Compiled loops multiply them: beyond 46341 dofs the product would turn negative."""
    rewrite_signed(flowing_path, array("flow.dofs", lambda a: a.astype(np.int32)))
    assert hhr.load_model(flowing_path).flow.operator.dofs.dtype == np.int64


def test_what_could_not_be_read_is_not_written(hertz_reduction, tmp_path):
    model = hertz_reduction
    broken = replace(model.fields, gap_scale=np.nan * model.fields.gap_scale)
    changed = hhr.ReducedModel(model.problem, model.parameters, broken, model.trained, known=model.known)
    with pytest.raises(ModelFileError, match="cannot be kept"):
        hhr.save_model(tmp_path / "model.npz", changed)
    with pytest.raises(TypeError, match="a Reconstruction cannot be kept in a file: it is no model"):
        hhr.save_model(tmp_path / "model.npz", model.fields)
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------- bodies that flow, laws and amplitudes of a user's own


def test_an_indicator_stays_behind_and_is_warned_of(hertz_reduction, tmp_path):
    model = hertz_reduction
    fields = replace(model.fields, indicator=lambda answer: 0.5, bound=None)
    estimating = hhr.ReducedModel(model.problem, model.parameters, fields, model.trained, known=model.known)
    assert estimating.solve(0.3).estimate() == Estimate.indicated(0.5)
    with pytest.warns(ModelFileWarning, match="indicator stays behind"):
        hhr.save_model(tmp_path / "model.npz", estimating)
    assert hhr.load_model(tmp_path / "model.npz").solve(0.3).estimate() is None


def test_stress_of_elastic_bodies_needs_the_mesh(path):
    with pytest.raises(HHRError, match=r"full\.stress_of\(answer\.displacement\(\)\)"):
        hhr.load_model(path).solve(0.3).stress()


MARCH = """
import sys
missing = ["dolfinx_solver", "dolfinx", "ufl", "basix", "gmsh", "petsc4py", "slepc4py", "mpi4py", "rich", "matplotlib"]
sys.modules.update(dict.fromkeys(missing))
import numpy as np, hhr_dolfinx as hhr
model, path = hhr.load_model(sys.argv[1]), np.load(sys.argv[2])
answers = model.march(list(zip(path[:, 0], path[:, 1:]))).answers
parts = [[a.unknown, a.multipliers, a.displacement(), a.forces(), a.plastic_strain()] for a in answers]
if answers[0].gauss is not None:
    parts = [[*part, a.stress().ravel()] for part, a in zip(parts, answers)]
np.save(sys.argv[3], np.array([np.concatenate(part) for part in parts]))
"""


def marched_elsewhere(file, path, folder):
    """Answers of a history, flat, by a process in which nothing of the full model can be imported."""
    np.save(folder / "path.npy", np.array([[time, *point] for time, point in path]))
    command = [sys.executable, "-c", MARCH, *(str(name) for name in (file, folder / "path.npy", folder / "out.npy"))]
    run = subprocess.run(command, capture_output=True, text=True, timeout=WAIT)
    assert run.returncode == 0, run.stderr[-2000:]
    return np.load(folder / "out.npy")


def flat(history):
    return np.array([np.concatenate([part.ravel() for part in bits(answer)]) for answer in history.answers])


@pytest.mark.filterwarnings("ignore::hhr_dolfinx.errors.OutsideTrainingWarning")
def test_a_machine_without_dolfinx_marches(flowing_path, flowing_reduction, tmp_path):
    """The same loops on the same arrays: to the last bit."""
    path = plastic_demo.path(10.0, 6)
    found = marched_elsewhere(flowing_path, path, tmp_path)
    assert found.tobytes() == flat(flowing_reduction.march(path)).tobytes()
    assert np.abs(found).max() > 0


def test_a_machine_without_dolfinx_marches_elastic_bodies(pellet_path, pellet_reduction, tmp_path):
    """LAPACK in both, since PETSc may be linked with another one."""
    model, path = pellet_reduction, [(0.0, (5.0, 0.6)), (1.0, (100.0, 2.0)), (2.0, (170.0, 3.2))]
    how = {"known": model.known, "factorise": LapackLU}
    same = hhr.ReducedModel(model.problem, model.parameters, model.fields, model.trained, **how)
    assert marched_elsewhere(pellet_path, path, tmp_path).tobytes() == flat(same.march(path)).tobytes()


def with_law(model, law):
    """The model with another law in its second body."""
    one, two = model.flow.material.groups
    flow = replace(model.flow, material=Material([one, replace(two, law=law)], model.flow.material.components))
    return hhr.ReducedModel(model.problem, model.parameters, model.fields, model.trained, flow=flow)


@pytest.mark.filterwarnings("ignore::hhr_dolfinx.errors.OutsideTrainingWarning")
def test_a_law_of_a_users_own_comes_back_if_its_class_is_given(flowing_reduction, tmp_path):
    model = with_law(flowing_reduction, Bingham(100.0, 1e5))
    hhr.save_model(tmp_path / "own.npz", model)
    with pytest.raises(ModelFileError, match=r"own\.npz.* holds a Bingham.*load_model\(path, known=\[Bingham\]\)$"):
        hhr.load_model(tmp_path / "own.npz")
    stored, path = hhr.load_model(tmp_path / "own.npz", known=[Bingham]), plastic_demo.path(10.0, 6)
    assert stored.flow.material.groups[1].law == Bingham(100.0, 1e5)
    assert flat(stored.march(path)).tobytes() == flat(model.march(path)).tobytes()


class Careless:
    """A law that is no data."""

    def flow(self, trial, plastic_strain, shear, dt):
        return 0 * trial, 0 * trial


def test_two_classes_of_one_name_are_told_before_anything_is_read(flowing_path):
    with pytest.raises(FileContentError, match=r"two classes are called Plasticity.* rename one"):
        hhr.load_model(flowing_path, known=[dataclasses.make_dataclass("Plasticity", [], frozen=True)])


def test_a_law_that_is_no_data_is_not_written(flowing_reduction, tmp_path):
    with pytest.raises(ModelFileError, match=r"Careless.* must be a frozen dataclass"):
        hhr.save_model(tmp_path / "own.npz", with_law(flowing_reduction, Careless()))
    assert not list(tmp_path.iterdir())


def test_an_elastic_body_beside_one_that_flows_has_no_law(flowing_reduction, tmp_path):
    hhr.save_model(tmp_path / "own.npz", with_law(flowing_reduction, None))
    assert hhr.load_model(tmp_path / "own.npz").flow.material.groups[1].law is None


def test_nothing_that_flowed_in_training(flowing_reduction, flowing_path):
    """Without modes for the plastic strain there is none outside the RID."""
    fields = replace(flowing_reduction.fields, flow=replace(flowing_reduction.fields.flow, cumulated=None))
    parts = flowing_reduction.problem, flowing_reduction.parameters, fields, None
    hhr.save_model(flowing_path, hhr.ReducedModel(*parts, flow=flowing_reduction.flow))
    stored = hhr.load_model(flowing_path)
    assert stored.fields.flow.cumulated is None and stored.trained is None
    assert stored.fields.flow.gauss_points == flowing_reduction.fields.flow.gauss_points


def test_an_amplitude_of_a_users_own(tmp_path):
    """A load of a user's own with a term that is not affine, through the whole chain to the file."""
    floor, top = block.side(1, upper=False), block.side(1, upper=True)
    held = [hhr.Displacement(block.side(0, upper=upper), 0) for upper in (False, True)]
    scene = dataclasses.replace(
        pressed_block("plane_strain"),
        displacements=(*held, hhr.Displacement(top, 1, hhr.Amplitude(slopes={"push": -1.0}))),
        loads=(WindLoad(floor, (0.0, -1.0), 3.0, "push"),),
    )
    full = hhr.FullOrderModel(scene)
    model = hhr.build(full, hhr.compute_snapshots(full, full.parameters.grid([9])), hhr.Recipe().as_it_is())
    hhr.save_model(tmp_path / "wind.npz", model)
    with pytest.raises(ModelFileError, match=r"holds a Square.*known=\[Square\]"):
        hhr.load_model(tmp_path / "wind.npz")
    stored = hhr.load_model(tmp_path / "wind.npz", known=[Square])
    assert all(map(np.array_equal, bits(stored.solve(0.07)), bits(by_lapack(model).solve(0.07))))


@pytest.mark.parametrize("known", [Bingham, "Bingham", 3, None], ids=repr)
def test_known_must_be_a_list(known, flowing_path):
    with pytest.raises(ModelFileError, match=r"must be a list of classes, load_model\(path, known=\[MyLaw\]\)"):
        hhr.load_model(flowing_path, known=known)


def test_a_missing_package_is_no_damage(flowing_path):
    """Nobody should build a model again where the loops of its flow cannot be compiled."""
    program = (
        f"import sys\nsys.modules['numba'] = None\nimport hhr_dolfinx as hhr\nhhr.load_model({str(flowing_path)!r})"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    last = run.stderr.strip().splitlines()[-1]
    assert last.startswith("hhr_dolfinx.errors.MissingPackageError") and "hhr_dolfinx[flow]" in last
