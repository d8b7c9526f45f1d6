"""Local models on disk and in tables: what is read is what was written, once, and nothing else is read."""

import csv
import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest
from bare import WAIT, arrays_of, rewrite_signed
from parted import (
    CUT,
    REACH,
    bits,
    by_lapack,
    choice,
    one_cut,
    parts_of,
    pellet_models,
    pellet_training,
    shaped_set,
    varying_set,
)
from scenes import largest_difference, pressed_block
from test_model_file import Toy, array, entry, rewrite
from test_mpi import launch
from test_mutations import trial
from toy_nonaffine_load import Square, WindLoad

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import BoundError, ModelFileError, ModelFileWarning, ReductionError
from hhr_dolfinx.geometries import block
from hhr_dolfinx.models.choice import LEAF, Choice
from hhr_dolfinx.models.local import LocalModels
from hhr_dolfinx.online.layout import CHOICE_LAYOUT
from hhr_dolfinx.study.console import make_console


@pytest.fixture(scope="module")
def training():
    return pellet_training()


@pytest.fixture(scope="module")
def local(training):
    """Three models, cut along both parameters."""
    models = [*pellet_models(training), *parts_of(training, [(2.0, 6.1)])]
    tree = choice([(1, CUT, 1, 2), (-1, 0), (0, 100.0, 3, 4), (-1, 2), (-1, 1)], (5.0, 0.4))
    return LocalModels(models, tree)


@pytest.fixture(scope="module")
def varying():
    return varying_set()[1]


@pytest.fixture(scope="module")
def shaped():
    return shaped_set()


@pytest.fixture(scope="module")
def kept(local, varying, shaped, tmp_path_factory):
    folder = tmp_path_factory.mktemp("kept")
    hhr.save_model(folder / "shaped.npz", shaped)
    hhr.save_model(folder / "local.npz", local)
    hhr.save_model(folder / "varying.npz", varying)
    hhr.save_model(folder / "two.npz", LocalModels(local.models[:2], one_cut(1, CUT, REACH)))
    return folder


@pytest.fixture
def path(kept, tmp_path):
    (tmp_path / "local.npz").write_bytes((kept / "local.npz").read_bytes())
    return tmp_path / "local.npz"


def points_of(model, count=40):
    """Random points and some by the first border."""
    points = model.parameters.random(2 * count, seed=9)
    axis = int(model.choice.axis[0])
    points[count:, axis] = model.choice.cut[0] + np.linspace(-1, 1, count) * model.choice.reach[axis]
    return points


# ---------------------------------------------------------------- what comes back


@pytest.mark.parametrize("name", ["local", "varying", "shaped"])
def test_a_set_comes_back_to_the_last_bit(name, kept, request):
    model, stored = by_lapack(request.getfixturevalue(name)), hhr.load_model(kept / f"{name}.npz")
    assert isinstance(stored, LocalModels) and stored.offline is None and len(stored) == len(model)
    asked = set()
    for point in points_of(model):
        mine, theirs = (one.solve(point, outside="ignore", gradient=True) for one in (stored, model))
        assert stored.model_of(mine) == model.model_of(theirs) and bits(mine) == bits(theirs)
        assert mine.estimate()[:5] == theirs.estimate()[:5]
        assert mine.gradient.multipliers.tobytes() == theirs.gradient.multipliers.tobytes()
        if model.fields.functionals is not None:
            assert dict(mine.outputs()) == dict(theirs.outputs())
        asked.add(stored.model_of(mine))
    assert asked == set(range(len(model)))
    for item in dataclasses.fields(Choice):
        assert np.array_equal(getattr(stored.choice, item.name), getattr(model.choice, item.name))


@pytest.mark.parametrize("name", ["local", "varying", "shaped"])
def test_arrays_lie_as_files_keep_them(name, request):
    """Else sums of a model that was read run in another order than those of the one that was written."""
    found = arrays_of(request.getfixturevalue(name))
    assert len(found) > 50 and not [array.strides for array in found if not array.flags.forc]


def test_many_answers_and_the_door_are_the_same(kept, local):
    stored, points = hhr.load_model(kept / "local.npz"), points_of(local)
    one, two = (model.solve_many(points) for model in (stored, by_lapack(local)))
    assert np.array_equal(one.model, two.model)
    assert b"".join(map(bits, one)) == b"".join(map(bits, two))
    for mine, theirs in zip(stored.models, local.models, strict=True):
        assert np.array_equal(mine.trained.lower, theirs.trained.lower)


def test_what_models_share_is_kept_once(kept, local, tmp_path):
    with np.load(kept / "local.npz") as file:
        header, names = json.loads(str(file["header"])), set(file.files)
        sizes = {name: file[name].nbytes for name in file.files}
    for name in ("bound.schur", "bound.lower", "bound.free_slack", "fields.gaps.values", "fields.lifts.values",
                 "amplitudes.slopes", "amplitudes0.positions", "output_bound.steepness", "response.loaded",
                 "fields.basis"):  # fmt: skip
        assert f"0.{name}" in names and not {f"1.{name}", f"2.{name}"} & names
        assert [place[name] for place in header["places"]] == [0, 0, 0]
    own = {f"{number}.reduced.stiffness" for number in range(3)}
    assert own <= names and set(CHOICE_LAYOUT) <= names
    stored = hhr.load_model(kept / "local.npz")
    for model in stored.models[1:]:
        assert model.fields.bound.schur is stored.models[0].fields.bound.schur
    assert not any("offline" in name or "labels" in name for name in sizes)
    twice = LocalModels([local.models[0]] * 2, one_cut(1, CUT, REACH))
    hhr.save_model(tmp_path / "twice.npz", twice)
    hhr.save_model(tmp_path / "once.npz", local.models[0])
    more = (tmp_path / "twice.npz").stat().st_size - (tmp_path / "once.npz").stat().st_size
    assert 0 < more < 16_000  # header and choice


def test_written_again_it_is_the_same_file(kept, tmp_path):
    for name in ("local", "varying", "shaped"):
        hhr.save_model(tmp_path / "again.npz", hhr.load_model(kept / f"{name}.npz"))
        with np.load(tmp_path / "again.npz") as mine, np.load(kept / f"{name}.npz") as theirs:
            assert mine.files == theirs.files and str(mine["header"]) == str(theirs["header"])


ELSEWHERE = """
import json, sys
missing = ["dolfinx_solver", "dolfinx", "ufl", "basix", "gmsh", "petsc4py", "slepc4py", "mpi4py", "rich", "matplotlib"]
if sys.argv[1] == "missing":
    sys.modules.update(dict.fromkeys(missing))
import numpy as np, hhr_dolfinx as hhr
model, points = hhr.load_model(sys.argv[2]), np.array(json.loads(sys.argv[3]))
answers = [model.solve(point, outside="ignore") for point in points]
found = [[model.model_of(answer), answer.forces().tolist(), *answer.estimate()[1:5]] for answer in answers]
table = hhr.answer_points(model, points, outside="ignore")
print(json.dumps([found, table.model.tolist()]))
heavy = {"dolfinx", "ufl", "gmsh", "pyvista", "matplotlib", "slepc4py", "petsc4py", "mpi4py"}
heavy &= {k for k, v in sys.modules.items() if v}
assert not heavy, heavy
"""


@pytest.mark.parametrize("petsc", ["there", "missing"])
@pytest.mark.parametrize("name", ["local", "varying", "shaped"])
def test_another_process_answers_without_dolfinx(name, petsc, kept, request):
    """To the last bit, whether PETSc is there or not: it is not loaded."""
    model = by_lapack(request.getfixturevalue(name))
    points = points_of(model, 4)
    command = [sys.executable, "-c", ELSEWHERE, petsc, str(kept / f"{name}.npz"), json.dumps(points.tolist())]
    run = subprocess.run(command, capture_output=True, text=True, timeout=WAIT)
    assert run.returncode == 0, run.stderr[-2000:]
    found, numbers = json.loads(run.stdout)
    answers = [model.solve(point, outside="ignore") for point in points]
    expected = [[model.model_of(answer), answer.forces().tolist(), *answer.estimate()[1:5]] for answer in answers]
    assert numbers == [row[0] for row in found] == [row[0] for row in expected]
    assert found == expected


def test_an_indicator_stays_behind(local, tmp_path):
    fields = dataclasses.replace(local.models[1].fields, indicator=lambda answer: 0.1)
    models = [local.models[0], local.models[1].changed(fields=fields), local.models[2]]
    with pytest.warns(ModelFileWarning, match="the indicator stays behind") as caught:
        hhr.save_model(tmp_path / "local.npz", LocalModels(models, local.choice))
    assert caught[0].filename == __file__
    assert hhr.load_model(tmp_path / "local.npz").models[1].fields.indicator is None


def test_amplitudes_of_a_users_own_come_back_if_their_class_is_given(tmp_path):
    top = block.side(1, upper=True)
    scene = dataclasses.replace(
        pressed_block("plane_strain"), loads=(WindLoad(block.side(0, upper=True), (-1.0, 0.0), 3.0, "push"),),
        displacements=(hhr.Displacement(block.side(0, upper=False), 0),
                       hhr.Displacement(top, 1, hhr.Amplitude(slopes={"push": -1.0}))),
    )  # fmt: skip
    training, file = hhr.train(scene, (9,), held_out=0), tmp_path / "own.npz"
    local = LocalModels(parts_of(training, [(0.0, 0.07), (0.03, 0.1)]), one_cut(0, 0.05, (0.01,)))
    hhr.save_model(file, local)
    with pytest.raises(ModelFileError, match=r"own\.npz cannot be read: the file holds a Square.*known=\[Square\]"):
        hhr.load_model(file)
    with pytest.raises(ModelFileError, match=r"two classes are called Square.* rename one"):
        hhr.load_model(file, known=[Square, dataclasses.make_dataclass("Square", [], frozen=True)])
    stored = hhr.load_model(file, known=[Square])
    for push in (0.02, 0.055, 0.09):
        assert bits(stored.solve(push)) == bits(by_lapack(local).solve(push))


def test_what_could_not_be_read_is_not_written(local, tmp_path):
    problem = local.models[1].problem
    for stiffness, why in ((np.inf * problem.stiffness, "not finite"), (problem.stiffness[:, :-1], "has shape")):
        bad = local.models[1].changed()
        bad.problem = dataclasses.replace(problem, stiffness=stiffness)
        with pytest.raises(ModelFileError, match=f"cannot be kept in .*{why}"):
            hhr.save_model(tmp_path / "bad.npz", LocalModels([local.models[0], bad, local.models[2]], local.choice))
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    "damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b"not a model", lambda b: b[:-40]]
)
def test_a_damaged_file_is_refused(path, damage):
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(ModelFileError, match="damaged"):
        hhr.load_model(path)


def test_a_changed_number_is_found(path):
    rewrite(path, lambda arrays: arrays["choice.cut"].__setitem__(0, 1.0))
    with pytest.raises(ModelFileError, match="checksum"):
        hhr.load_model(path)


def header(**values):
    return lambda header, arrays: header.update(values)


def of_model(number, **values):
    return lambda header, arrays: header["models"][number].update(values)


def place(number, name, value):
    return lambda header, arrays: header["places"][number].update({name: value})


def moved(one, other):
    return lambda header, arrays: arrays.update({other: arrays.pop(one)})


def box(number, **values):
    return lambda header, arrays: header["models"][number]["parameters"].update(values)


REFUSED = {
    # the choice
    "cuts of a choice .* are no tree": entry("choice.high", 0, 1),
    "choice between models are no tree": array("choice.low", np.zeros_like),
    "no tree": entry("choice.low", 2, 10**9),
    r"cuts axes \[-1  0  7\]": entry("choice.axis", 0, 7),
    r"cuts axes \[-5": entry("choice.axis", 0, -5),
    "not among 3 local ones": entry("choice.label", 1, 3),
    "has no model": entry("choice.label", 1, -1),
    "choice.cut is not finite": entry("choice.cut", 0, np.nan),
    "choice.reach is not finite": entry("choice.reach", 0, np.inf),
    "cuts axes": entry("choice.reach", 0, -1.0),
    "choice of 1 parameters is none|of 1": array("choice.reach", lambda a: a[:1]),
    "choice of 3 parameters is none": array("choice.reach", lambda a: np.append(a, 1.0)),
    "choice.cut has shape": array("choice.cut", lambda a: a[:-1]),
    "choice.axis has type float64": array("choice.axis", lambda a: a.astype(float)),
    "choice.label has type bool": array("choice.label", lambda a: a.astype(bool)),
    "at least one": lambda header, arrays: arrays.update(
        {name: arrays[name][:0] for name in CHOICE_LAYOUT if name != "choice.reach"}
    ),
    r"\['choice.cut'\] are missing": lambda header, arrays: arrays.pop("choice.cut"),
    r"\['choice.more'\] are unknown": lambda header, arrays: arrays.update({"choice.more": np.zeros(1)}),
    # where arrays lie
    r"\['3.reduced.loads'\] are unknown": lambda header, arrays: arrays.update({"3.reduced.loads": np.zeros((2, 2))}),
    "array bound.schur of model 0 is missing": lambda header, arrays: arrays.pop("0.bound.schur"),
    "reduced.stiffness of model 1 is missing: 2": place(1, "reduced.stiffness", 2),
    "reduced.stiffness of model 1 is missing: -1": place(1, "reduced.stiffness", -1),
    "reduced.stiffness of model 1 is missing: 1.0": place(1, "reduced.stiffness", 1.0),
    "reduced.stiffness of model 1 is missing: True": place(1, "reduced.stiffness", True),
    "reduced.stiffness of model 1 is missing: '1'": place(1, "reduced.stiffness", "1"),
    r"reduced.stiffness of model 1 is missing: \[\]": place(1, "reduced.stiffness", []),
    "more of model 1 is missing: 0": place(1, "more", 0),
    r"\['1.reduced.stiffness'\] are unknown": place(1, "reduced.stiffness", 0),
    "places in its header must be a list": header(places={}),
    "places in its header": header(places=[1, 2, 3]),
    "3 models and places of 0": header(places=[]),
    "of model 2 is missing": lambda header, arrays: header["places"].__setitem__(2, {"reduced.stiffness": 5}),
    # the models
    "the models in its header": header(models="three"),
    "models in its header must": header(models=[None] * 3),
    "0 models and places of 3": header(models=[]),
    "local models are a list": lambda header, arrays: (
        header.update(models=[], places=[]), [arrays.pop(name) for name in list(arrays) if name[0] != "c"],
    ),
    "its header has the keys": header(more=1),
    "of version 3, this release reads": header(of=3),
    "of version 'new'": header(of="new"),
    "header has the keys": of_model(1, more=1),
    "dimension must be 2 or 3": of_model(2, dimension=7),
    "amplitudes, laws, outputs": of_model(0, outputs="peak"),
    "the parameters must have": of_model(1, parameters=None),
    "local model 1 is of another scene": box(1, upper=[400.0, 6.0]),
    "local model 2 is of another scene": box(2, names=["P1", "h2"]),
    "must be increasing": box(0, upper=[0.0, 0.0]),
    "1.reduced.loads is not finite": entry("1.reduced.loads", (0, 0), np.nan),
    "stiffness has shape": array("1.reduced.stiffness", lambda a: a[:-1]),
    "singular": entry("2.reduced.stiffness", slice(None), 0.0),
    "A_lambda has indices outside": entry("1.fields.A_lambda", 0, 10**6),
    "the factor of S": array("0.bound.schur", lambda a: 2 * a),
    "arrays .'reduced.stiffness'. are missing": lambda header, arrays: (
        header["places"][1].pop("reduced.stiffness"), arrays.pop("1.reduced.stiffness"),
    ),
    "unknown": lambda header, arrays: header["places"][1].pop("reduced.stiffness"),
    "laws of flow, and nothing flows": of_model(0, laws=[None]),
}  # fmt: skip


def check_refused(path, why, change):
    rewrite_signed(path, change)
    with pytest.raises(ModelFileError, match=f"local.npz .*({why}).*build the model again"):
        hhr.load_model(path, known=[Toy])


@pytest.mark.parametrize("why", REFUSED)
def test_a_signed_file_of_other_content_is_refused_where_it_is_read(why, path):
    check_refused(path, why, REFUSED[why])


def test_a_signed_file_that_was_not_changed_is_read(path, local):
    """Else the tests above would pass with a wrong signature."""
    rewrite_signed(path, lambda header, arrays: None)
    assert bits(hhr.load_model(path).solve((50.0, 5.0))) == bits(by_lapack(local).solve((50.0, 5.0)))
    rewrite_signed(path, header(version=99))
    with pytest.raises(ModelFileError, match="'hhr_dolfinx local models' version 99"):
        hhr.load_model(path)


def test_models_of_other_scenes_are_refused(path, training):
    """A file may name what is shared in its own way, and still no models of other materials go together."""

    def stiffer(header, arrays):
        header["places"][1] |= {"bound.schur": 1, "bound.lower": 1}
        arrays |= {"1.bound.schur": 1.21 * arrays["0.bound.schur"], "1.bound.lower": 1.1 * arrays["0.bound.lower"]}

    check_refused(path, "local model 1 is of another scene or mesh", stiffer)


def test_parts_of_a_stiffness_that_varies_are_looked_at_too(kept, tmp_path):
    path = tmp_path / "local.npz"
    for why, change in {
        "is no tree": of_model(1, varying=[]),
        "which is unknown here": of_model(1, varying={
            name: {"kind": "Popen", "fields": {}}
            for name in ("terms", "reshaped", "compliances", "known", "contact", "bound", "outputs")
        }),
        "missing": lambda header, arrays: arrays.pop("1.varying.terms.stiffness"),
    }.items():  # fmt: skip
        path.write_bytes((kept / "varying.npz").read_bytes())
        check_refused(path, why, change)


def test_places_of_parts_that_are_not_there_are_refused(kept, tmp_path):
    """Of what is interpolated between parameters: conditions, terms of θ, axes, levels."""
    path, tried = tmp_path / "local.npz", 0
    with np.load(kept / "varying.npz") as file:
        names = [name for name in file.files if "compliances.parts" in name and file[name].dtype.kind == "i"]
        names = [name for name in names if file[name].size]
    for name in names:
        for number in (-1, 10**6):
            path.write_bytes((kept / "varying.npz").read_bytes())
            check_refused(path, "places from 0|levels of an interpolation|must increase", entry(name, -1, number))
            tried += 1
    assert tried == 18
    assert {name.rsplit(".", 1)[1] for name in names} >= {"conditions", "forced", "levels"}


def test_a_set_is_no_file_of_one_model(path, local):
    rewrite_signed(path, header(format="hhr_dolfinx reduced model"))
    with pytest.raises(ModelFileError, match="version 1, this release reads"):
        hhr.load_model(path)
    for nothing in (None, [local.models[0]], local.choice):
        with pytest.raises(TypeError, match="cannot be kept in a file: it is no model"):
            hhr.save_model(path, nothing)


@pytest.mark.parametrize(
    "count, seed",
    [pytest.param(40, 1, id="sample"), pytest.param(200, 2, id="full", marks=pytest.mark.slow)],
)
def test_mutated_sets(count, seed, kept, tmp_path):
    wrong, refused = trial("model", kept / "two.npz", tmp_path / "mutants", count, seed)
    assert not wrong
    assert refused > 0.5 * count


# ---------------------------------------------------------------- tables


def test_tables_say_which_model_answered(local, kept, tmp_path, capsys):
    points = np.vstack([points_of(local, 10), [[1e9, 1.0]]])
    answers = hhr.answer_points(local, points)
    alone = hhr.answer_points(local.models[0], points, outside="ignore")
    assert list(answers.outputs) == list(alone.outputs) and list(answers.estimates) == list(alone.estimates)
    assert alone.model is None and answers.fell_back is None
    assert answers.model.dtype == np.int64 and answers.model[-1] == LEAF and answers.status[-1] != "ok"
    for k, point in enumerate(points[:-1]):
        answer = local.solve(point)
        assert answers.model[k] == local.model_of(answer)
        # many at once share products of matrices, whose last digits differ from those of one
        assert largest_difference(answers.forces[k], answer.forces()) < 1e-12
        assert answers.outputs["peak [MPa]"][k] == pytest.approx(answer.outputs()["peak"], rel=1e-12)
        bound = answer.estimate().outputs["peak"]
        assert answers.estimates["bound of peak [MPa]"][k] == pytest.approx(bound, rel=1e-6)
    assert hhr.write_answers(tmp_path / "answers.csv", local.parameters, answers) == 1
    with open(tmp_path / "answers.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["model"] for row in rows] == [*(str(number) for number in answers.model[:-1]), ""]
    assert list(rows[0]).index("model") == list(rows[0]).index("force_0") - 1
    np.savetxt(tmp_path / "points.csv", points, delimiter=",", header="P1,h1", comments="")
    given = hhr.read_points(tmp_path / "points.csv", local.parameters)
    assert hhr.answer_table(local, given, tmp_path / "again.csv", make_console()) == 1
    assert "20 answers and 1 bad rows" in capsys.readouterr().out
    nothing = hhr.answer_points(local, np.zeros((0, 2)))
    assert nothing.model.shape == (0,)


ON_RANKS = """
import sys
import hhr_dolfinx as hhr
from hhr_dolfinx.study.console import make_console
model = hhr.load_model(sys.argv[1])
hhr.answer_table(model, hhr.read_points(sys.argv[2], model.parameters), sys.argv[3], make_console())
"""


def test_on_two_ranks_a_table_is_the_same(kept, local, tmp_path):
    np.savetxt(tmp_path / "points.csv", points_of(local, 15), delimiter=",", header="P1,h1", comments="")
    texts = []
    for ranks in (1, 2):
        out = tmp_path / f"answers{ranks}.csv"
        launch(ranks, ["-c", ON_RANKS, str(kept / "local.npz"), str(tmp_path / "points.csv"), str(out)])
        texts.append(out.read_text())
    assert texts[0] == texts[1]
    with open(tmp_path / "answers2.csv", newline="") as file:
        assert {row["model"] for row in csv.DictReader(file)} == {"0", "1", "2"}


def test_local_models_fall_back_on_the_full_one(local, training, tmp_path):
    model, points = hhr.FallbackModel(local, training.full_order, 1e-3), np.vstack([points_of(local, 20), [[1e9, 1.0]]])
    answers = hhr.answer_points(model, points)
    fell = answers.fell_back
    assert 0 < fell.sum() == model.fallen < 40
    assert (answers.model[fell] == LEAF).all() and (answers.model[:40][~fell[:40]] >= 0).all()
    for k in np.flatnonzero(~fell[:40]):
        estimate = local.solve(points[k]).estimate()
        assert max(estimate.primal_relative, estimate.dual_relative) <= 1e-3
    assert hhr.write_answers(tmp_path / "answers.csv", model.parameters, answers) == 1
    with open(tmp_path / "answers.csv", newline="") as file:
        rows = list(csv.DictReader(file))[:40]
    assert all((row["model"] == "") == (row["fell_back"] == "1") for row in rows)
    assert hhr.answer_points(hhr.FallbackModel(local.models[0], training.full_order), points[:2]).model is None


def test_a_fallback_looks_at_local_models_as_at_one(local, training, varying):
    with pytest.raises(ReductionError, match="has the parameters"):
        hhr.FallbackModel(varying, training.full_order)
    bare = [model.changed(fields=dataclasses.replace(model.fields, bound=None)) for model in local.models]
    with pytest.raises(BoundError, match="have no bound"):
        hhr.FallbackModel(LocalModels(bare, local.choice), training.full_order)
