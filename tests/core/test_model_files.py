"""Files of models of all kinds: what is read is what was written, to the last bit, and nothing else
is read.
"""

import copy
import dataclasses
import json
import pickle
import shutil
from dataclasses import dataclass, replace
from functools import cache

import contract
import numpy as np
import pytest
from bare_problem import arrays_of, rewrite_signed
from flowing import demo as plastic
from flowing import flowing_full, flowing_reduction, pellet_of_moduli
from flowing import pellet_path as heated
from kept_values import array, both, entry, node_of, put, rewrite_model
from local_models_by_hand import (
    CUT,
    REACH,
    by_lapack,
    one_cut,
    parts_of,
    pellet_training,
    three_models,
)
from needs import needs, present
from processes import python
from scenes import pressed_block, slope
from threads import at_once
from toy_law import Bingham
from toy_nonaffine_load import Square, WindLoad

import hhr_dolfinx as hhr
from hhr_dolfinx.declared import annotations_of, declared_array
from hhr_dolfinx.errors import HHRError, ModelFileError, ModelFileWarning, NotOfferedError
from hhr_dolfinx.geometries import block
from hhr_dolfinx.geometries import pellet_cladding as geometry
from hhr_dolfinx.models.estimates import Estimate
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.online.model_file import MODEL_FORMAT, MODEL_VERSION, MODULES, Kinds, check_answers
from hhr_dolfinx.plain import as_plain, restored

OF_MESH = {
    "full",
    "full, friction",
    "full, friction and flowing",
    "full, flowing",
    "naive",
    "fallback",
}
OF_CONTRACT = tuple(
    kind for kind in contract.KINDS if kind not in {*OF_MESH, "interpolated condensation, floating"}
)
LOCAL = ("local pellet",) if present("local_models") else ()
FLOWING = ("condensed pellet", "flowing pellet") if present("inelastic", "nonmatching") else ()
PELLET = ("pellet", *LOCAL, *FLOWING)
ALL = (*OF_CONTRACT, *PELLET)
QUICK = {
    "exact condensation", "interpolated condensation, moduli", "HHR, constant", "HHR, moduli",
    "exact condensation, friction", "HHR, floating", "pellet", *LOCAL, *FLOWING[1:],
}  # fmt: skip


def quick(kind, *given):
    """A case, slow where its kind is."""
    return pytest.param(kind, *given, marks=() if kind in QUICK else pytest.mark.slow)


KINDS = [quick(kind) for kind in ALL]
QUIET = hhr.MarchSettings(outside="ignore")
OUTPUTS = (
    hhr.LargestPressure("peak", 0, unit="MPa"),
    *((hhr.VonMises("mean", geometry.PELLET, "mean"),) if present("stress") else ()),
    hhr.DisplacementAt("u", (4.7, 6.0), 0, unit="mm"),
)


def corrected(full, known):
    from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings

    return hhr.build(full, known, CorrectionSettings(attempts=1, trust=None))


@pytest.fixture(scope="module")
def models():
    """One model of each kind: those of the contract, and pellets with pressures on parts of lines,
    laws, outputs.
    """
    trained = cache(pellet_training)

    @cache
    def made(kind):
        if kind in OF_CONTRACT:
            return contract.model_of(kind)
        if kind == "flowing pellet":
            return flowing_reduction(flowing_full())
        if kind == "condensed pellet":
            full = hhr.FullOrderModel(pellet_of_moduli(outputs=OUTPUTS))
            known = hhr.SnapshotSet.of_histories(
                [full.march(heated(*item)) for item in ((5.0, 160e3), (12.0, 220e3))]
            )
            return corrected(full, known)
        if kind == "pellet":
            return hhr.build(trained().full_order, trained().snapshots, hhr.Recipe().as_it_is())
        return three_models(trained())

    return made


@pytest.fixture(scope="module")
def kept(models, tmp_path_factory):
    folder = tmp_path_factory.mktemp("kept")

    @cache
    def saved(kind):
        path = folder / f"{ALL.index(kind)}.npz"
        hhr.save_model(path, models(kind))
        return path

    return saved


@pytest.fixture
def file(kept, tmp_path):
    return lambda kind="pellet": shutil.copy(kept(kind), tmp_path / "model.npz")


def called(name):
    return dataclasses.make_dataclass(name, [], frozen=True)


def refused(path, why, **how):
    with pytest.raises(ModelFileError, match=why):
        hhr.load_model(path, **how)


def points_of(model, count=5):
    return model.parameters.random(count, seed=9)


def answers_of(model):
    """Answers to some points, or along a path where bodies flow."""
    space = model.parameters
    if model.equilibrium is None:
        return [model.solve(point, outside="ignore") for point in points_of(model)]
    if "gap" in space.names and "E" in space.names:
        path = heated(9.0, 180e3)
    else:
        path = plastic.path(8.0, 5) if "gap" in space.names else contract.path(0.05)
    return list(model.march(path, QUIET).answers)


def bits(model):
    return bits_of(answers_of(model), model.fields.functionals is not None)


def bits_of(answers, outputs=False):
    found = []
    for answer in answers:
        parts = [
            answer.parameter,
            answer.unknown,
            answer.multipliers,
            answer.displacement(),
            answer.forces(),
        ]
        if "gauss" in answer.memory:
            parts += [answer.stress(), answer.plastic_strain()]
        estimate = answer.estimate()
        found += [part.tobytes() for part in parts]
        found.append(None if estimate is None else tuple(estimate[:5]))
        found.append(dict(answer.outputs()) if outputs else None)
    return repr(found)


def same_library(model):
    """A model as a file holds it: factored by LAPACK, which differs from PETSc in last digits."""
    if isinstance(model, hhr.ReducedModel) or hasattr(model, "models"):
        return by_lapack(model)
    found = pickle.loads(pickle.dumps(model))
    if getattr(getattr(found, "eliminated", None), "factorise", None) is not None:
        found = found.changed(
            eliminated=type(found.eliminated).from_file(
                **{name: getattr(found.eliminated, name) for name in ("responses", "amplitudes")}
            )
        )
    return found


# ---------------------------------------------------------------- what comes back


@pytest.mark.parametrize("kind", KINDS)
def test_a_model_comes_back_to_the_last_bit(kind, models, kept):
    """Its answers, and every array and number that it is made of; written again it is the same."""
    model, stored = models(kind), hhr.load_model(kept(kind))
    assert type(stored) is type(model) and stored.offline is None
    assert bits(stored) == bits(same_library(model))
    (mine, own), (theirs, others) = as_plain(stored), as_plain(model.for_file())
    assert mine == theirs and own.keys() == others.keys()
    for name, found in own.items():
        assert found.dtype == others[name].dtype and found.tobytes("K") == others[name].tobytes(
            "K"
        ), name


@pytest.mark.parametrize("kind", KINDS)
def test_copies_answer_alike(kind, models):
    for copied in (copy.deepcopy, lambda model: pickle.loads(pickle.dumps(model))):
        again = copied(models(kind))
        assert bits(again) == bits(models(kind)) and again.offline is None


@pytest.mark.parametrize("kind", KINDS)
def test_arrays_lie_as_files_keep_them(kind, models):
    """Else sums of a model that was read run in another order than those of the one that was
    written.
    """
    found = arrays_of(models(kind).for_file())
    # arrays of exact condensation lie in one, which copies make again
    assert kind.startswith("exact") or not [
        array.strides for array in found if not array.flags.forc
    ]


def test_a_file_holds_whatever_class_declares():
    """Each class that may come out declares the kind and the sizes of all its arrays, but those of
    outputs.
    """
    kinds = Kinds()
    for module, names in MODULES.items():
        for name in names.split():
            for field, node in annotations_of(kinds[name]).items():
                text = str(getattr(node, "id", getattr(node, "attr", "")))
                if text in (
                    "ndarray",
                    "Floats",
                    "Integers",
                    "Booleans",
                    "csc_matrix",
                    "csr_matrix",
                ):
                    assert module == "models.functionals.kinds" and declared_array(node) is None, (
                        f"{name}.{field}"
                    )


ALONE = """
import sys
missing = ["dolfinx_solver", "dolfinx", "ufl", "basix", "gmsh", "petsc4py", "slepc4py", "mpi4py",
           "rich", "matplotlib", "meshio", "shapely", "sklearn", "pyvista", "resource"]
if sys.argv[1] == "missing":
    sys.modules.update(dict.fromkeys(missing))
import json, hhr_dolfinx as hhr
for kind, name in json.loads(sys.argv[2]).items():
    model = hhr.load_model(name)
    point = [(low + high) / 2 for low, high in zip(model.parameters.lower, model.parameters.upper)]
    answer = model.solve(point, outside="ignore", raise_on_failure=False)
    values = {} if model.fields.functionals is None else dict(answer.outputs())
    bits = [found.tobytes().hex() for found in (answer.forces(), answer.displacement())]
    print(json.dumps([kind, *bits, repr(values)]))
heavy = {"dolfinx", "ufl", "gmsh", "pyvista", "matplotlib", "slepc4py", "petsc4py", "mpi4py"}
heavy &= {name for name, module in sys.modules.items() if module}
assert not heavy, heavy
"""


CLASSES = """
import sys
sys.modules.update(dict.fromkeys(sys.argv[1].split()))
from hhr_dolfinx import registry
from hhr_dolfinx.online.model_file import PLACES
for place in (registry.named("classes") | PLACES).values():
    print(registry.load(place).__name__)
"""


def test_classes_of_files_need_no_dolfinx():
    """All that a file may hold is imported where there is numpy and scipy alone."""
    packages = (
        "dolfinx_solver dolfinx ufl basix gmsh petsc4py slepc4py mpi4py rich meshio shapely pyvista"
    )
    assert len(python("-W", "ignore", "-c", CLASSES, packages).stdout.split()) > 20


@pytest.mark.parametrize("petsc", ["there", "missing"])
def test_another_process_answers_without_dolfinx(petsc, kept, models):
    """To the last bit, whether there is more than numpy and scipy or not, and numba where bodies
    flow.
    """
    names = json.dumps({kind: str(kept(kind)) for kind in ALL})
    lines = [json.loads(line) for line in python("-c", ALONE, petsc, names).stdout.splitlines()]
    assert [line[0] for line in lines] == list(ALL)
    for kind, forces, displacement, values in lines:
        model = hhr.load_model(kept(kind))
        middle = np.mean([model.parameters.lower, model.parameters.upper], axis=0)
        answer = model.solve(middle, outside="ignore", raise_on_failure=False)
        assert (
            answer.forces().tobytes().hex() == forces
            and answer.displacement().tobytes().hex() == displacement
        )
        assert values == (
            "{}" if model.fields.functionals is None else repr(dict(answer.outputs()))
        )


def test_an_elastic_model_loads_no_flow(kept):
    """Nor numba, nor what only takes time to load; a scene pulls in what it names."""
    program = f"import sys, hhr_dolfinx as hhr\nhhr.load_model({str(kept('pellet'))!r})\n" + (
        "late = 'numba', 'scipy.optimize', 'scipy.spatial', 'scipy.interpolate'\n"
        "found = [m for m in sys.modules if m in late or "
        "m.startswith('hhr_dolfinx.plugins.inelastic.update')]\nassert not found, found"
    )
    python("-c", program)


@needs("inelastic", "nonmatching")
def test_zeros_are_not_stored_and_keep_their_sign(models, kept, tmp_path):
    model = models("condensed pellet")
    given = np.zeros_like(model.fields.given)
    given[3, 1], given[5, 2] = -0.0, 2.0
    hhr.save_model(tmp_path / "model.npz", model.changed(fields=replace(model.fields, given=given)))
    with np.load(tmp_path / "model.npz") as found:
        assert found["fields.given.places"].size == 2 and "fields.given" not in found.files
    assert hhr.load_model(tmp_path / "model.npz").fields.given.tobytes("A") == given.tobytes("A")
    # of the gaps of 42 terms only one column is not zero: 16 bytes for each condition
    with np.load(kept("pellet")) as found:
        size = sum(found[name].nbytes for name in found.files if name.startswith("fields.gaps"))
    assert size <= 16 * len(models("pellet").fields.gaps)


@needs("local_models", "exact_errors")
def test_what_models_share_is_kept_once(models, kept, tmp_path):
    """S, the free slack, the modes of a basis that all have."""
    stored = hhr.load_model(kept("local pellet"))
    for model in stored.models[1:]:
        for name in ("schur", "cross", "free_slack"):
            assert getattr(model.fields.bound, name) is getattr(stored.models[0].fields.bound, name)
        assert model.fields.basis is stored.models[0].fields.basis
    local = models("local pellet")
    hhr.save_model(
        tmp_path / "twice.npz", hhr.LocalModels([local.models[0]] * 2, one_cut(1, CUT, REACH))
    )
    hhr.save_model(tmp_path / "once.npz", local.models[0])
    more = (tmp_path / "twice.npz").stat().st_size - (tmp_path / "once.npz").stat().st_size
    assert 0 < more < 30_000  # the tree again, small arrays, and the choice


@needs("inelastic", "nonmatching")
def test_gradients_come_back(models, kept):
    """Along moduli too; von Mises' stress at Gauss points has none."""
    model = models("condensed pellet")
    some = replace(model.fields.functionals, items=model.fields.functionals.items[::2])
    model = model.changed(fields=replace(model.fields, functionals=some))
    again = pickle.loads(pickle.dumps(model))
    settings = hhr.MarchSettings(relative_force=1e-10, outside="ignore", gradient=True)
    one, other = (
        item.march(heated(9.0, 180e3), settings).answers[-1].outputs() for item in (again, model)
    )
    assert one.values == other.values and one.units == other.units == {"peak": "MPa", "u": "mm"}
    assert all(
        one.gradient[name].tobytes() == other.gradient[name].tobytes() for name in ("peak", "u")
    )
    assert other.gradient["u"].all()


@needs("inelastic", "nonmatching")
@pytest.mark.usefixtures("restless")
def test_threads_ask_one_model(models):
    """Each with elasticity of its own, half of them with a law of a user: the answers are those of
    one thread.
    """
    varied = models("condensed pellet")
    for model in (varied, with_law(varied, stated(Bingham(100.0, 1e5)))):
        asked = [
            heated(gap, young)
            for gap, young in ((5.0, 160e3), (8.0, 180e3), (10.0, 200e3), (12.0, 220e3))
        ]
        jobs = [
            lambda item=item, model=model: [
                bits_of(model.march(item, QUIET).answers) for _ in range(3)
            ]
            for item in asked
        ]
        expected = [job() for job in jobs]
        assert at_once(jobs) == expected
        assert at_once(jobs[:1] * 4) == expected[:1] * 4


# ---------------------------------------------------------------- a user's own laws and amplitudes;
# what is left out


def with_law(model, law):
    """A flowing model with another law in its second body."""
    if isinstance(model, hhr.ReducedModel):
        material = model.flow.material
        one, two = material.groups
        changed = type(material)([one, replace(two, law=law)], material.components, material.names)
        return model.changed(flow=replace(model.flow, material=changed))
    one, two = model.flow.groups
    return model.changed(flow=replace(model.flow, groups=(one, replace(two, law=law))))


def stated(law):
    """A law as models have it."""
    from hhr_dolfinx.plugins.inelastic.law import program_of

    return None if law is None else program_of(law, 4)


@needs("inelastic", "nonmatching")
@pytest.mark.parametrize("kind", ["flowing pellet", "condensed pellet"])
def test_a_law_of_a_users_own_comes_back_without_its_class(kind, models, tmp_path):
    model, own = with_law(models(kind), stated(Bingham(100.0, 1e5))), tmp_path / "own.npz"
    hhr.save_model(own, model)
    assert bits(hhr.load_model(own)) == bits(model)
    for law in (
        None,
        hhr.Norton("900 + P1", 4.0) if kind == "condensed pellet" else hhr.Norton(900.0, 4.0),
    ):
        hhr.save_model(own, with_law(models(kind), stated(law)))
        stored = hhr.load_model(own)
        groups = stored.flow.groups if kind == "condensed pellet" else stored.flow.material.groups
        values = None if groups[1].law is None else groups[1].law.values
        assert values == (None if law is None else (law.resistance, law.exponent))
    hhr.save_model(own, models(kind).changed(trained=None))
    assert hhr.load_model(own).trained is None


class Careless:
    """A law that answers as a program does, and whose class is no dataclass."""

    def __init__(self, program):
        self.program = program

    def __getattr__(self, name):
        if name == "program":  # copies ask for it before they have it
            raise AttributeError(name)
        return getattr(self.program, name)


@needs("local_models")
def test_an_amplitude_of_a_users_own(tmp_path):
    """A load of a user's own with a term that is not affine, through the whole chain to the file,
    alone and in sets.
    """
    held = [hhr.Displacement(block.side(0, upper=upper), 0) for upper in (False, True)]
    top, floor = (block.side(1, upper=upper) for upper in (True, False))
    scene = replace(
        pressed_block("plane_strain"), loads=(WindLoad(floor, (0.0, -1.0), 3.0, "push"),),
        displacements=(*held, hhr.Displacement(top, 1, slope("push", -1.0))),
    )  # fmt: skip
    training, own = hhr.train(scene, (9,), held_out=0), tmp_path / "own.npz"
    whole = hhr.build(training.full_order, training.snapshots, hhr.Recipe().as_it_is())
    local = hhr.LocalModels(
        parts_of(training, [(0.0, 0.07), (0.03, 0.1)]), one_cut(0, 0.05, (0.01,))
    )
    for model in (whole, local):
        hhr.save_model(own, model)
        refused(own, r"own\.npz cannot be read: the file holds a Square.*known=\[Square\]")
        refused(
            own, r"two classes are called Square.* rename one", known=[Square, called("Square")]
        )
        assert bits(hhr.load_model(own, known=[Square])) == bits(by_lapack(model))


@needs("local_models")
def test_an_indicator_stays_behind_and_is_warned_of(models, tmp_path):
    model, local = models("pellet"), models("local pellet")
    fields = replace(
        model.fields,
        indicator=lambda answer: 0.5,
        bound=None,
        response=None,
        basis=np.ones((len(model.fields.basis), len(model.problem.stiffness))),
        contact_basis=np.ones((len(model.fields.gaps), len(model.problem.stiffness))),
        output_bound=None,
        force_snapshots=np.ones((len(model.fields.gaps), 1)),
    )
    estimating, point = model.changed(fields=fields), points_of(model, 1)[0]
    assert estimating.solve(point, outside="ignore").estimate() == Estimate.indicated(0.5)
    other = model.changed(fields=replace(model.fields, indicator=lambda answer: 0.1))
    for one in (estimating, hhr.LocalModels([model, other, local.models[2]], local.choice)):
        with pytest.warns(ModelFileWarning, match="indicator is left out") as caught:
            hhr.save_model(tmp_path / "model.npz", one)
        assert caught[0].filename == __file__
    hhr.save_model(tmp_path / "model.npz", estimating.for_file())
    stored = hhr.load_model(tmp_path / "model.npz")
    assert (
        stored.solve(point, outside="ignore").estimate() is None
        and "no code" in stored.fields.unbounded
    )
    with pytest.raises(HHRError, match=r"full\.stress_of\(displacement, mu\)"):
        stored.solve(point, outside="ignore").stress()


@needs("local_models", "inelastic", "nonmatching")
def test_what_could_not_be_read_is_not_written(models, tmp_path):
    model, flow = models("pellet"), models("condensed pellet")
    problem, local = model.problem, models("local pellet")
    careless = Careless(stated(hhr.Norton(900.0, 4.0)))
    bad = local.models[1].changed()
    bad.problem = replace(problem, stiffness=problem.stiffness[:, :-1])
    broken = [
        (
            model.changed(fields=replace(model.fields, gap_scale=np.nan * model.fields.gap_scale)),
            "not finite",
        ),
        (with_law(models("flowing pellet"), careless), "must be a frozen dataclass"),
        (with_law(flow, careless), "must be a frozen dataclass"),
        (flow.changed(flow=replace(flow.flow, modal=np.nan * flow.flow.modal)), "not finite"),
        (
            flow.changed(flow=replace(flow.flow, modal=flow.flow.modal[:, :-1])),
            "flow.modal has shape",
        ),
        (hhr.LocalModels([local.models[0], bad, local.models[2]], local.choice), "has shape"),
    ]
    for item, why in broken:
        with pytest.raises(ModelFileError, match=f"cannot be kept in .*{why}"):
            hhr.save_model(tmp_path / "model.npz", item)
    for nothing in (model.fields, None, [model], local.choice):
        with pytest.raises(TypeError, match="cannot be kept in a file: it is no model"):
            hhr.save_model(tmp_path / "model.npz", nothing)
    with pytest.raises(NotOfferedError, match="needs the mesh"):
        hhr.save_model(tmp_path / "model.npz", contract.model_of("full"))
    assert not list(tmp_path.iterdir())


@needs("inelastic", "nonmatching")
def test_nothing_that_flowed_in_training(models, tmp_path):
    """Without modes for the plastic strain there is none outside the RID."""
    model = models("flowing pellet")
    fields = replace(model.fields, flow=replace(model.fields.flow, cumulated=None))
    hhr.save_model(tmp_path / "model.npz", model.changed(fields=fields, trained=None))
    stored = hhr.load_model(tmp_path / "model.npz")
    assert stored.fields.flow.cumulated is None and stored.trained is None
    assert stored.fields.flow.gauss_points == model.fields.flow.gauss_points


@needs("inelastic", "nonmatching")
@pytest.mark.parametrize("how", ["points of the RID", "condensed"])
def test_models_in_space_come_back(how, tmp_path):
    law = hhr.Plasticity(0.02, 0.5)
    scene = pressed_block("solid", cells=2)
    scene = replace(scene, bodies=(replace(scene.bodies[0], law=law),))
    full = hhr.FullOrderModel(scene)
    path = [(0.25 * k, [share]) for k, share in enumerate((0.0, 0.03, 0.06, 0.09, 0.04))]
    known = hhr.SnapshotSet.of_histories([full.march(path)])
    if how == "condensed":
        model = corrected(full, known)
    else:
        model = hhr.build(full, known, hhr.Recipe.flowing().as_it_is())
    hhr.save_model(tmp_path / "model.npz", model)
    one, other = (
        item.march(path, QUIET).answers for item in (hhr.load_model(tmp_path / "model.npz"), model)
    )
    assert bits_of(one) == bits_of(other) and one[-1].plastic_strain().any()


@needs("inelastic", "nonmatching")
def test_indices_of_four_bytes_are_widened(file):
    """Compiled loops multiply them: beyond 46341 dofs the product would turn negative."""
    path = file("flowing pellet")
    rewrite_model(path, array("flow.operator.dofs", lambda a: a.astype(np.int32)))
    assert hhr.load_model(path).flow.operator.dofs.dtype == np.int64


# ---------------------------------------------------------------- files that are damaged or others


def unsigned(path, change):
    with np.load(path) as found:
        arrays = dict(found)
    change(arrays)
    with open(path, "wb") as out:
        np.savez(out, **arrays)


def in_header(**values):
    def change(arrays):
        arrays["header"] = np.array(json.dumps(json.loads(arrays["header"].item()) | values))

    return change


@pytest.mark.parametrize(
    "why, change",
    [
        ("checksum", lambda arrays: arrays["problem.stiffness"].__setitem__((0, 0), 1.0)),
        ("checksum", in_header(model={})),
        (
            "'hhr_dolfinx model' version 99, this release reads .*build the model again",
            in_header(version=99),
        ),
        (
            (
                "'hhr_dolfinx reduced model' version 13, this release reads 'hhr_dolfinx model' "
                "version"
            ),
            in_header(format="hhr_dolfinx reduced model", version=13),
        ),
        ("names no 'hhr_dolfinx model'", in_header(format="something else")),
        (
            "damaged",
            lambda arrays: arrays.__setitem__("problem.loads", np.array([{}], dtype=object)),
        ),
        ("no header", lambda arrays: arrays.pop("header")),
    ],
)
def test_other_files_are_refused(why, change, file):
    path = file()
    unsigned(path, change)
    refused(path, f"(?s){why}")


@pytest.mark.parametrize(
    "damage",
    [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b"not a model", lambda b: b[:-40]],
)
def test_a_damaged_file_is_refused(damage, file):
    path = file()
    path.write_bytes(damage(path.read_bytes()))
    refused(path, "damaged")


def test_a_missing_file_a_folder_and_wrong_classes(tmp_path, kept):
    refused(tmp_path / "nothing.npz", "no model file")
    refused(tmp_path, "is a folder, and a model is a file")
    refused(
        kept("pellet"), r"two classes are called Coverage.* rename one", known=[called("Coverage")]
    )
    for known in (Bingham, "Bingham", 3, None):
        refused(
            kept("pellet"),
            r"must be a list of classes, load_model\(path, known=\[MyLaw\]\)",
            known=known,
        )


@needs("inelastic", "nonmatching")
def test_flow_is_answered_without_numba(models, kept):
    """Slowly, as a warning says."""
    kind = "condensed pellet"
    model = models(kind)
    point = np.mean([model.parameters.lower, model.parameters.upper], axis=0).tolist()
    ask = f"import hhr_dolfinx as hhr\nmodel = hhr.load_model({str(kept(kind))!r})\n"
    ask += f"print(repr(float(model.solve({point}, outside='ignore').forces().sum())))"
    run = python("-c", f"import sys\nsys.modules['numba'] = None\n{ask}")
    assert "hhr_dolfinx[flow]" in run.stderr
    assert float(run.stdout) == pytest.approx(
        model.solve(point, outside="ignore").forces().sum(), rel=1e-9
    )


# ---------------------------------------------------------------- a valid checksum and other
# content


@dataclass(frozen=True)
class Toy:
    """A value that is neither a law nor an amplitude."""


TOY = {"kind": "Toy", "fields": {}}
KNOWN = Kinds([Toy])
FREE = (
    "force_snapshots",
    "choice.",
    "steps",
    "nonaffine",
    "functionals",
    "interpolant",
    "primal",
    "known",
    "bound.loads",
    "bound.lifts",
)
"""Parts whose sizes nothing else shares, so that fewer are as good."""


def damaged(arrays):
    """Each array lost, of another kind, with another number of dimensions, cut along each axis, or
    not finite.
    """
    for name, found in arrays.items():
        yield name, "lost", None
        yield name, "kind", found.astype(bool) if found.dtype.kind == "f" else found.astype(float)
        yield name, "dimensions", found[None]
        for axis in range(found.ndim):
            yield (
                name,
                f"cut along {axis}",
                np.delete(found, 0, axis) if found.shape[axis] else found[None],
            )
        if found.dtype.kind == "f" and found.size:
            yield (
                name,
                "not finite",
                np.where(np.arange(found.size).reshape(found.shape) == 0, np.nan, found),
            )
        if found.dtype.kind == "i" and found.size:
            for number in (-1, 10**7):
                yield (
                    name,
                    f"index {number}",
                    np.where(np.arange(found.size).reshape(found.shape) == 0, number, found),
                )


@pytest.mark.parametrize("kind", KINDS)
def test_arrays_that_were_damaged_are_refused(kind, models):
    """Whatever is done to them: by what classes declare, by what they say of themselves, or by a
    first answer.
    """
    tree, arrays = as_plain(models(kind).for_file())
    taken = []
    for name, what, found in damaged(arrays):
        changed = {key: value for key, value in arrays.items() if key != name}
        try:
            check_answers(
                restored(tree, changed if found is None else changed | {name: found}, KNOWN)
            )
        except HHRError:
            continue
        taken.append(f"{name}: {what}")
    free = ("lost", "kind", "dimensions", "not finite")
    assert not [item for item in taken if item.split(": ")[1] in free]
    assert not [item for item in taken if "cut" in item and not any(part in item for part in FREE)]
    assert len(taken) < 0.12 * sum(1 for _ in damaged(arrays))


def box(**values):
    return both(*(put(f"parameters.{name}", value) for name, value in values.items()))


def one_dof_less(tree, arrays):
    """Of all that knows them."""
    count, terms = node_of(tree, "fields.lifts")["shape"]
    node_of(tree, "fields.lifts")["shape"] = [count - 1, terms]
    put("fields.functionals.size", count - 1)(tree, arrays)
    for name in ("fields.basis", "fields.response.loaded"):
        array(name, lambda a: a[:-1])(tree, arrays)


LINE, LAWS, GROUPS = "fields.amplitudes.nonaffine.0", "flow.material.groups", "flow.groups"
REFUSED = {
    "pellet": [
        ("there twice: they are dependent", entry("fields.A_lambda", 0, 1)),
        ("gap_scale has the entry 0.0", array("fields.gap_scale", lambda a: 0.0 * a)),
        ("singular", entry("problem.stiffness", slice(None), 0.0)),
        (
            "0 of .* modes are no|10 of 10 modes|modes are no rigid motions",
            put("problem.motions", 10),
        ),
        ("first amplitude must be", entry("fields.amplitudes.constant", 0, 2.0)),
        ("the amplitudes are 1", array(f"{LINE}.positions", lambda a: a[:-1])),
        ("must be an Amplitude", put("fields.amplitudes.nonaffine", [TOY])),
        (
            "is no Functional, and an",
            both(put("fields.output_bound", None), put("fields.functionals.items", [TOY])),
        ),
        ("trained range ends below", array("trained.upper", lambda a: a - 1e6)),
        ("dofs are no nodes", one_dof_less),
        ("dimension 4, which must be", put("fields.dimension", 4)),
        ("dimension of Reconstruction is 'two', and must be a int", put("fields.dimension", "two")),
        ("nothing completes them|neither training forces", put("fields.bound", None)),
        (
            "neither training forces nor a bound",
            both(put("fields.bound", None), put("fields.response", None)),
        ),
        (
            "at least one",
            both(
                *(
                    array(f"known.{name}", lambda a: a[:0])
                    for name in ("points", "active", "margins", "slopes")
                )
            ),
        ),
        (
            "S of its estimate is not symmetric and positive",
            array("fields.bound.schur", lambda a: 0 * a),
        ),
        ("S of its estimate is not symmetric", array("fields.bound.schur", np.tril)),
        ("are negative", array("fields.bound.least", lambda a: a - 1e9)),
        ("not one more than another", put("fields.bound.kept", None)),
        ("estimates of outputs are not those", put("fields.functionals", None)),
        (
            "estimates of outputs are not those",
            array("fields.output_bound.least", lambda a: -0.5 - np.abs(a)),
        ),
        ("outside 0 .. ", array("fields.functionals.items.0.conditions", lambda a: a + 1000)),
        ("starts from known statuses", put("known", None)),
        ("P = 3", box(names=["a", "b", "c"], lower=[0.0] * 3, upper=[1.0] * 3)),
        ("names of ParameterSpace is .*must be", box(names=[1, 2])),
        ("lower of ParameterSpace is", box(lower=[None, 1.0])),
        ("is no model", lambda tree, arrays: (arrays.clear(), tree.clear(), tree.update(TOY))),
        ("must have a kind and fields", lambda tree, arrays: tree.clear()),
        ("arrays .'more'. are unknown", lambda tree, arrays: arrays.update(more=np.ones(1))),
    ],
    "flowing pellet": [
        ("4 components in dimension 3|no nodes", put("fields.dimension", 3)),
        ("values of the stress", array("fields.flow.stress.fit", lambda a: a[:, :-1])),
        ("plastic strains are not one", array("fields.flow.cumulated.fit", lambda a: a[:, :-1])),
        ("indices outside", put("fields.flow.gauss_points", 3)),
        ("not those of its strain", array("flow.cells", lambda a: a[:-1])),
        ("not those of its strain", put("flow.operator.size", 10**6)),
        ("young = -1.0", put(f"{LAWS}.0.young", -1.0)),
        ("poisson = 0.5", put(f"{LAWS}.0.poisson", 0.5)),
        ("each of its Gauss points", entry(f"{LAWS}.0.indices", 0, 1)),
        ("not those of its strain", put(f"{LAWS}", [])),
        ("components in dimension", put("flow.material.components", 6)),
        ("a Gauss point has the weight", entry("flow.operator.weights", (0, 0), 0.0)),
        ("a dof of A is there twice", array("flow.inner", np.zeros_like)),
        ("trained steps take", put("trained.steps", [2.0, 1.0])),
        ("steps of TrainedPaths is", put("trained.steps", [2.0, 3.0, 1.0])),
        ("must be a LawProgram", put(f"{LAWS}.1.law", TOY)),
        ("does not fit its program", put(f"{LAWS}.1.law.values", [1.0])),
        (
            "no program: an operation is unknown",
            array(f"{LAWS}.1.law.program.rows", lambda a: a + 100),
        ),
        ("not those of the moduli", put(f"{LAWS}.0.young", "2e5")),
    ],
    "HHR, moduli": [
        ("neither training forces|do not go together|nothing completes", put("fields.bound", None)),
        ("no parts|stiffness has|parts", put("problem.terms.moduli", [])),
    ],
    "condensed pellet": [
        ("indices outside|has a number twice", entry("flow.points", 0, 10**6)),
        ("parts has indices outside", entry("flow.parts", 0, 2)),
        ("fields.parts has indices outside", entry("fields.parts", 0, 7)),
        (
            "flow.points has a number twice",
            both(
                *(
                    array(f"{name}.points", lambda a: np.r_[a[1], a[1:]])
                    for name in ("flow", "fields.flow")
                )
            ),
        ),
        ("are not the same", array("fields.flow.points", lambda a: a[::-1].copy())),
        ("points that flowed must increase", array("fields.flow.flowed", lambda a: a[::-1].copy())),
        (
            "elasticity of a Gauss point is not positive",
            entry("fields.flow.elastic", (0, 0, 0), 0.0),
        ),
        ("groups must hold the points", entry(f"{GROUPS}.0.indices", 0, 1)),
        ("one after another", array(f"{GROUPS}.1.indices", lambda a: a[::-1].copy())),
        ("groups must hold", array(f"{GROUPS}.1.indices", lambda a: a[:-1])),
        ("schur is not symmetric", entry("flow.schur", (0, 0, 1), 3.0)),
        ("schur is not positive definite", entry("flow.schur", (0, 2, 2), -1.0)),
        ("a condition has no compliance", entry("flow.schur", (slice(None), 2, 2), 0.0)),
        (
            "the moduli are .* in the middle",
            both(
                *(array(f"{name}.factors.middle", lambda a: 2 * a) for name in ("flow", "fields"))
            ),
        ),
        (
            "moduli of the step and those of the fields",
            array("fields.factors.middle", lambda a: 2 * a),
        ),
        ("names .'F'.*, the parameters are", put("flow.factors.moduli.0.factor", "F")),
        ("of the step and those of the fields", put("flow.factors.moduli.0.factor", "2 * E")),
        (
            "young = E - 2e5 is -10000 .*positive",
            both(
                *(put(f"{name}.factors.moduli.0.factor", "E - 2e5") for name in ("flow", "fields"))
            ),
        ),
        (
            "no formula of",
            both(*(put(f"{name}.factors.moduli.0.rest", "w") for name in ("flow", "fields"))),
        ),
        ("not on the part of this modulus", put(f"{GROUPS}.0.young", "78e3 * w")),
        ("young = 190000.0 are not on the part", put(f"{GROUPS}.0.young", 190e3)),
        ("young = -1.0 and poisson", put(f"{GROUPS}.0.young", -1.0)),
        ("poisson = 0.5 are no", put(f"{GROUPS}.0.poisson", 0.5)),
        ("poisson = E is 190000", put(f"{GROUPS}.0.poisson", "E")),
        ("is 'Plasticity', and must be a LawProgram", put(f"{GROUPS}.0.law", "Plasticity")),
        ("trained of CondensedFlowModel is True", put("trained", True)),
        ("plastic of PlasticFields is None", put("fields.flow.plastic", None)),
        ("dimension 4", put("fields.dimension", 4)),
        ("components of a strain in dimension 3|no nodes", put("fields.dimension", 3)),
        ("must be a LawProgram", put(f"{GROUPS}.1.law", TOY)),
        (
            "law 0: yield_stress = -.* must be a number above 0",
            put(f"{GROUPS}.0.law.values", ["P1 - 300", 1e3]),
        ),
        ("names .'F'.* correct the formula", put(f"{GROUPS}.0.law.values", ["F", 1e3])),
        ("trained range ends below", array("trained.parameters.upper", lambda a: a - 1e6)),
        ("it was trained on", put("trained.parameters.names", ["P1"] * 5)),
        ("the estimates of the training", put("trained.estimate", -1.0)),
        ("holds a Popen, which is unknown", put("flow.factors", {"kind": "Popen", "fields": {}})),
        ("no formula|parameters", box(names=["P1", "h1", "gap", "w", "E"])),
        ("indices outside 0 .. 5", put("fields.flow.strain.size", 6)),
    ],
    "local pellet": [
        ("are no tree", entry("choice.high", 0, 1)),
        ("not among 3 local ones", entry("choice.label", 1, 3)),
        ("of 3 parameters does not suit", array("choice.reach", lambda a: np.append(a, 1.0))),
        ("local models are a list", put("models", [])),
        ("another scene", put("models.1.parameters.upper", [400.0, 6.0])),
        ("singular", entry("models.2.problem.stiffness", slice(None), 0.0)),
    ],
}


@needs("exact_errors")
@pytest.mark.parametrize(
    "kind, number",
    [quick(kind, k) for kind, rows in REFUSED.items() if kind in ALL for k in range(len(rows))],
)
def test_a_signed_file_of_other_content_is_refused_where_it_is_read(kind, number, file):
    why, change = REFUSED[kind][number]
    path = file(kind)
    rewrite_model(path, change)
    said = why if "Popen" in why else f"(?s)model.npz .*({why}).*build the model again"
    refused(path, said, known=[Toy])


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.values[0] in REFUSED])
def test_a_signed_file_that_was_not_changed_is_read(kind, file):
    """Else the tests above would pass with a wrong signature."""
    path = file(kind)
    rewrite_signed(path, lambda header, arrays: None)
    assert (MODEL_FORMAT, MODEL_VERSION) == ("hhr_dolfinx model", 8) and hhr.load_model(path)
    rewrite_signed(path, lambda header, arrays: header.update(more=1))
    refused(path, "its header has the keys")


def test_fields_that_declare_no_size_of_the_loads_are_told_so():
    """A stranger's fields: the size was a KeyError."""
    (said,) = KeptModel.faults(None, {})
    assert said == "no array of its fields declares the size of θ: Annotated[Floats, ..., 'terms']"
