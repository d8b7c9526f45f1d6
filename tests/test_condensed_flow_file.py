"""Models of condensed flow on disk, copied, and shared by threads: the same bits everywhere."""

import copy
import dataclasses
import pickle
import subprocess
import sys
import warnings
from pathlib import Path

import flowing
import numpy as np
import pellet_cladding_plastic as demo
import pytest
from bare import WAIT, rewrite_signed
from marched import bits, of_answer
from test_flow_moduli import path, pellet
from test_model_file import TOY, Careless, Toy, array, check_alike, entry, header, number
from test_threads import at_once
from toy_law import Bingham

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ModelFileError, OutsideTrainingError, OutsideTrainingWarning
from hhr_dolfinx.geometries import pellet_cladding as geometry
from hhr_dolfinx.models.condensed_fields import CondensedFlowFields
from hhr_dolfinx.models.condensed_flow import CondensedFlow
from hhr_dolfinx.online.layout import CONDENSED_FLOW_INDICES, CONDENSED_FLOW_LAYOUT
from hhr_dolfinx.reduction.condense_flow import CorrectionSettings, condense_flow

OUTPUTS = (
    hhr.LargestPressure("peak", 0, unit="MPa"),
    hhr.VonMises("mean", geometry.PELLET, "mean"),
    hhr.DisplacementAt("u", (4.7, 6.0), 0, unit="mm"),
)
QUIET = hhr.MarchSettings(outside="ignore")
TIGHT = hhr.MarchSettings(relative_force=1e-10, outside="ignore", gradient=True)
AS_IT_IS = CorrectionSettings(attempts=1, trust=None)


def condensed(scene, paths):
    full = hhr.FullOrderModel(scene)
    return condense_flow(full, hhr.SnapshotSet.of_histories([full.march(item) for item in paths]), AS_IT_IS)


@pytest.fixture(scope="module")
def plain():
    """Constant elasticity, no outputs."""
    return condensed(demo.scene(**flowing.SMALL_MESH), [demo.path(gap, flowing.STEPS) for gap in flowing.TRAINING])


@pytest.fixture(scope="module")
def varied():
    """Both moduli depend on parameters; with outputs."""
    scene = pellet(outputs=OUTPUTS)
    return condensed(scene, [path(5.0, 160e3), path(12.0, 220e3)])


@pytest.fixture(scope="module")
def kept(plain, varied, tmp_path_factory):
    """Both files."""
    folder = tmp_path_factory.mktemp("kept")
    hhr.save_model(folder / "plain.npz", plain)
    hhr.save_model(folder / "varied.npz", varied)
    return folder


ASKED = path(9.0, 180e3)
"""No training history."""


NAMES = tuple(item.name for item in OUTPUTS)


def test_a_file_answers_to_the_last_bit(kept, plain, varied):
    """Histories, fields, outputs, single steps, and derivatives along all parameters, moduli too."""
    stored = hhr.load_model(kept / "varied.npz")
    for asked in (ASKED, path(5.0, 160e3), path(15.0, 230e3, w=0.8)):
        assert bits(stored.march(asked, QUIET), NAMES) == bits(varied.march(asked, QUIET), NAMES)
    point = {"P1": 200.0, "h1": 0.9, "gap": 5e-3, "E": 170e3, "w": 0.9}
    assert of_answer(stored.solve(point, outside="ignore")) == of_answer(varied.solve(point, outside="ignore"))
    again, other = hhr.load_model(kept / "plain.npz"), demo.path(8.0, 7)
    assert bits(again.march(other, QUIET)) == bits(plain.march(other, QUIET))
    found, expected = stored.march(ASKED, TIGHT), varied.march(ASKED, TIGHT)
    assert bits(found) == bits(expected) and expected.answers[-1].gradient.unknown[:, 3].any()
    assert stored.dimension == 2 and stored.offline is None and again.fields.functionals is None


def test_derivatives_of_outputs_come_back(varied, tmp_path):
    """Von Mises' stress at Gauss points has none."""
    some = dataclasses.replace(varied.fields.functionals, items=varied.fields.functionals.items[::2])
    model = varied.changed(fields=dataclasses.replace(varied.fields, functionals=some))
    hhr.save_model(tmp_path / "model.npz", model)
    stored = hhr.load_model(tmp_path / "model.npz")
    one, other = (item.march(ASKED, TIGHT).answers[-1].outputs() for item in (stored, model))
    assert one.values == other.values and one.units == other.units == {"peak": "MPa", "u": "mm"}
    assert all(one.gradient[name].tobytes() == other.gradient[name].tobytes() for name in ("peak", "u"))
    assert other.gradient["u"].all()


def test_every_array_comes_back(kept, plain, varied):
    for name, model in (("plain", plain), ("varied", varied)):
        stored = hhr.load_model(kept / f"{name}.npz")
        check_alike(stored.parameters, model.parameters)
        check_alike(stored.trained, model.trained)
        check_alike(stored.flow, model.flow, but=("groups",))
        check_alike(stored.fields, model.fields, but=("functionals",))
        for one, other in zip(stored.flow.groups, model.flow.groups, strict=True):
            check_alike(one, other, but=("law",))
            assert one.law == other.law
        assert stored.fields.factors is stored.flow.factors and stored.fields.flow.points is stored.flow.points


def test_the_table_has_a_line_for_every_array():
    """A field that is added must not be forgotten: what is no array is named here."""
    others = {"flow.groups", "flow.per_cell", "flow.factors"}
    others |= {f"fields.{name}" for name in ("amplitudes", "factors", "dimension", "flow", "functionals")}
    parts = {"flow": CondensedFlow, "fields": CondensedFlowFields}
    names = {f"{part}.{item.name}" for part, kind in parts.items() for item in dataclasses.fields(kind)}
    assert names - others == {name for name in CONDENSED_FLOW_LAYOUT if name.count(".") == 1 and "trained" not in name}
    assert set(CONDENSED_FLOW_INDICES) <= set(CONDENSED_FLOW_LAYOUT)


def test_zeros_are_not_stored_and_keep_their_sign(plain, tmp_path):
    given = np.zeros_like(plain.fields.given)
    given[3, 1], given[5, 2] = -0.0, 2.0
    hhr.save_model(tmp_path / "model.npz", plain.changed(fields=dataclasses.replace(plain.fields, given=given)))
    with np.load(tmp_path / "model.npz") as file:
        assert file["fields.given.places"].size == 2 and "fields.given" not in file.files
    assert hhr.load_model(tmp_path / "model.npz").fields.given.tobytes("A") == given.tobytes("A")


def test_the_door_asks_as_before(kept, varied):
    """The same warnings, with the same words, and the same refusals."""
    told = []
    for model in (hhr.load_model(kept / "varied.npz"), varied):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            model.march(path(16.0, 160e3))
        told.append([str(item.message) for item in caught if item.category is OutsideTrainingWarning])
        with pytest.raises(OutsideTrainingError, match="gap"):
            model.march(path(16.0, 160e3), hhr.MarchSettings(outside="refuse"))
        with pytest.raises(hhr.errors.ParameterError, match="E changes"):
            model.march([(0.0, ASKED[0][1]), (1.0, path(9.0, 170e3)[-1][1])])
    assert told[0] == told[1] and any("gap" in text for text in told[0])


ELSEWHERE = """
import sys
missing = ["dolfinx_solver", "dolfinx", "ufl", "basix", "gmsh", "petsc4py", "slepc4py", "mpi4py", "rich", "matplotlib"]
sys.modules.update(dict.fromkeys(missing))
import pickle, hhr_dolfinx as hhr
sys.path.append(sys.argv[1])
from marched import bits
model = hhr.load_model(sys.argv[2])
with open(sys.argv[3], "rb") as file:
    asked, names, settings = pickle.load(file)
with open(sys.argv[4], "wb") as file:
    pickle.dump([bits(model.march(asked, item), outputs) for item, outputs in zip(settings, (names, ()))], file)
"""


def test_a_machine_without_dolfinx_and_petsc_answers(kept, varied, tmp_path):
    """The same loops on the same arrays: to the last bit."""
    (tmp_path / "asked").write_bytes(pickle.dumps((ASKED, NAMES, (QUIET, TIGHT))))
    names = (Path(__file__).parent, kept / "varied.npz", tmp_path / "asked", tmp_path / "found")
    command = [sys.executable, "-c", ELSEWHERE, *map(str, names)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=WAIT)
    assert run.returncode == 0, run.stderr[-2000:]
    expected = [bits(varied.march(ASKED, QUIET), NAMES), bits(varied.march(ASKED, TIGHT))]
    assert pickle.loads((tmp_path / "found").read_bytes()) == expected


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda model: pickle.loads(pickle.dumps(model))])
def test_copies_answer_alike(copied, varied):
    again = copied(varied)
    assert bits(again.march(ASKED, QUIET), NAMES) == bits(varied.march(ASKED, QUIET), NAMES)
    assert again.offline is None and varied.offline is not None
    with pytest.raises(OutsideTrainingError):
        again.march(path(16.0, 160e3), hhr.MarchSettings(outside="refuse"))


def test_threads_ask_one_model(varied):
    """Each with elasticity of its own, half of them with a law in Python: the answers are those of one thread."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        for model in (varied, with_law(varied, Bingham(100.0, 1e5))):
            asked = [path(gap, young) for gap, young in ((5.0, 160e3), (8.0, 180e3), (10.0, 200e3), (12.0, 220e3))]
            jobs = [lambda item=item, model=model: [bits(model.march(item, QUIET), NAMES) for _ in range(3)]
                    for item in asked]  # fmt: skip
            expected = [job() for job in jobs]
            assert at_once(jobs) == expected
            assert at_once(jobs[:1] * 4) == expected[:1] * 4
    finally:
        sys.setswitchinterval(before)


def with_law(model, law):
    """The model with another law in its second body."""
    one, two = model.flow.groups
    return model.changed(flow=dataclasses.replace(model.flow, groups=(one, dataclasses.replace(two, law=law))))


def test_a_law_of_a_users_own_comes_back_if_its_class_is_given(plain, tmp_path):
    model, file, asked = with_law(plain, Bingham(100.0, 1e5)), tmp_path / "own.npz", demo.path(8.0, 4)
    hhr.save_model(file, model)
    with pytest.raises(ModelFileError, match=r"own\.npz.* holds a Bingham.*load_model\(path, known=\[Bingham\]\)$"):
        hhr.load_model(file)
    stored = hhr.load_model(file, known=[Bingham])
    assert stored.flow.groups[1].law == Bingham(100.0, 1e5)
    assert bits(stored.march(asked, QUIET)) == bits(model.march(asked, QUIET))
    hhr.save_model(file, with_law(plain, None).changed(trained=None))
    stored = hhr.load_model(file)
    assert stored.flow.groups[1].law is None and stored.trained is None
    hhr.save_model(file, with_law(plain, hhr.Norton("900 + P1", 4.0)))
    assert hhr.load_model(file).flow.groups[1].law == hhr.Norton("900 + P1", 4.0)


def test_what_could_not_be_read_is_not_written(plain, tmp_path):
    flow = plain.flow
    broken = [
        (with_law(plain, Careless()), "must be a frozen dataclass"),
        (plain.changed(flow=dataclasses.replace(flow, modal=np.nan * flow.modal)), "not finite"),
        (plain.changed(flow=dataclasses.replace(flow, modal=flow.modal[:, :-1])), "flow.modal has shape"),
    ]
    for model, why in broken:
        with pytest.raises(ModelFileError, match=f"cannot be kept.*{why}"):
            hhr.save_model(tmp_path / "model.npz", model)
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------- a valid checksum and other content


def part(*names, value):
    """Another value in the tree: names of parts within parts, numbers of items."""

    def change(header, arrays):
        place = header["tree"]
        for name in names[:-1]:
            place = place[name]["items"] if "items" in place[name] else place[name].get("fields", place[name])
        place[names[-1]] = value

    return change


def text(value):
    return {"value": value}


def both(*changes):
    return lambda header, arrays: [item(header, arrays) for item in changes]


def dropped(*names):
    return lambda header, arrays: [arrays.pop(name) for name in names]


def given(*places):
    return both(
        array("fields.given.places", lambda a: np.array(places)),
        array("fields.given.values", lambda a: np.ones(len(places))),
    )


def box(**values):
    fields = {name: {"items": [text(item) for item in items]} for name, items in values.items()}
    return lambda header, arrays: header["tree"]["parameters"]["fields"].update(fields)


REFUSED = {
    "per_mode.* is not finite": entry("flow.per_mode", (0, 0), np.nan),
    "tested has shape .* strains = ": array("flow.per_mode", lambda a: a[:, :-1]),
    "has shape .* it must be \\(modes": array("flow.tested", lambda a: a[:-1]),
    "per_force has shape": array("flow.per_force", lambda a: a[:, :-1]),
    "moved has shape .*m = 6": array("flow.per_force", lambda a: a[:-1]),
    "flow.moved has shape": array("flow.moved", lambda a: a[:, :-1]),
    "flow.modal has shape": array("flow.modal", lambda a: a[0]),
    "flow.coupled has shape": array("flow.coupled", lambda a: a[:, :-1]),
    "flow.schur has shape": array("flow.schur", lambda a: a[:, :-1]),
    "flow.pressed has shape": array("flow.pressed", lambda a: a[0]),
    "flow.gaps has shape": array("flow.gaps", lambda a: a[:, :-1]),
    "flow.tested has type int64": array("flow.tested", lambda a: a.astype(np.int64)),
    "fields.basis has shape": array("fields.basis", lambda a: a[:-1]),
    "fields.per_force has shape": array("fields.per_force", lambda a: a[:, :-1]),
    "plastic.fit has shape": array("fields.flow.plastic.fit", lambda a: a[:, :-1]),
    "are not 4 at": array("fields.flow.plastic.modes", lambda a: a[:-1]),
    "flow.moved has shape .*plastic modes": array("fields.flow.moved", lambda a: a[:, :-1]),
    "flow.moved has shape .*N = ": array("fields.flow.moved", lambda a: a[:-1]),
    "gradients has shape": array("fields.flow.strain.gradients", lambda a: a[:, :, :3]),
    "weights has shape": array("fields.flow.strain.weights", lambda a: a[:-1]),
    "strain.dofs has indices outside": entry("fields.flow.strain.dofs", (0, 0), 10**6),
    "flowed has indices outside": entry("fields.flow.flowed", -1, 10**6),
    "points that flowed must increase": array("fields.flow.flowed", lambda a: a[::-1].copy()),
    "moduli of a Gauss point": entry("fields.flow.moduli", (0, 1), 0.0),
    "flow.moduli has shape": array("fields.flow.moduli", lambda a: a[:, :1]),
    "not those of .* dofs": part("fields", "flow", "strain", "size", value=text(6)),
    "sparse matrix .* outside of it": array("fields.flow.unstressed.values", lambda a: np.ones(3)),
    "or of \\(544, 13\\) terms": part("fields", "flow", "unstressed", "shape", value=[544, 1]),
    "cumulated.modes has shape": array("fields.flow.cumulated.modes", lambda a: a[:-1]),
    "slopes has shape": array("fields.amplitudes.slopes", lambda a: a[:, :1]),
    "trained.slowest has shape": array("trained.slowest", lambda a: a[:-1]),
    "strains are not": both(
        array("flow.points", lambda a: a[:-1]), array("fields.flow.points", lambda a: a[:-1]),
        array("flow.parts", lambda a: a[:-1]), array("fields.flow.cumulated.fit", lambda a: a[:, :-1]),
    ),
    "fields.given has places outside": given(-1),
    "places outside of it": given(10**7),
    "or twice": given(3, 3),
    "flow.given must have places": array("flow.given.values", lambda a: np.ones(1)),
    "flow.points has indices outside": entry("flow.points", 0, 10**6),
    "flow.parts has indices outside": entry("flow.parts", 0, 2),
    "flow.mode_parts has indices outside 0": entry("flow.mode_parts", 0, -1),
    "fields.parts has indices outside": entry("fields.parts", 0, 7),
    "flow.points has a number twice": both(
        array("flow.points", lambda a: np.r_[a[1], a[1:]]), array("fields.flow.points", lambda a: np.r_[a[1], a[1:]])
    ),
    "are not the same": array("fields.flow.points", lambda a: a[::-1].copy()),
    "groups must hold the points": entry("flow.groups.0.indices", 0, 1),
    "must hold the points .* behind another": array("flow.groups.1.indices", lambda a: a[::-1].copy()),
    "groups must hold": array("flow.groups.1.indices", lambda a: a[:-1]),
    "'points of group 0'. are zero": array("flow.groups.0.indices", lambda a: a[:0]),
    "schur is not symmetric": entry("flow.schur", (0, 0, 1), 3.0),
    "schur is not positive definite": entry("flow.schur", (0, 2, 2), -1.0),
    "a condition has no compliance": entry("flow.schur", (slice(None), 2, 2), 0.0),
    "the moduli are .* in the middle": both(
        array("flow.factors.middle", lambda a: 2 * a), array("fields.factors.middle", lambda a: 2 * a)
    ),
    "moduli of the step and those of the fields": array("fields.factors.middle", lambda a: 2 * a),
    "names .'F'.*, the parameters are": part("flow", "factors", "moduli", 0, "factor", value=text("F")),
    "of the step and those of the fields": part("flow", "factors", "moduli", 0, "factor", value=text("2 * E")),
    "young = E - 2e5 is -10000 .*positive": both(
        *(part(name, "factors", "moduli", 0, "factor", value=text("E - 2e5")) for name in ("flow", "fields"))
    ),
    "no formula of": both(
        *(part(name, "factors", "moduli", 0, "rest", value=text("w")) for name in ("flow", "fields"))
    ),
    "not on the part of this modulus": part("flow", "groups", 0, "young", value=text("78e3 * w")),
    "young = 190000.0 are not on the part": part("flow", "groups", 0, "young", value=text(190e3)),
    "young = -1.0 and poisson": part("flow", "groups", 0, "young", value=text(-1.0)),
    "poisson = 0.5 are no": part("flow", "groups", 0, "poisson", value=text(0.5)),
    "poisson = 'E' are no": part("flow", "groups", 0, "poisson", value=text("E")),
    "other kinds": part("flow", "groups", 0, "law", value=text("Plasticity")),
    "its parts are of other kinds": part("flow", "groups", value=text(3)),
    "parts are of other kinds": part("trained", value=text(True)),
    "of other kinds than": part("fields", "flow", "plastic", value=text(None)),
    "arrays .'flow.modal'. are missing": both(part("flow", "modal", value=text(1.0)), dropped("flow.modal")),
    "the array 'flow.modal' is missing": dropped("flow.modal"),
    "flow.forced'. are missing": dropped("flow.forced"),
    "'more'. are unknown": lambda header, arrays: arrays.update(more=np.zeros(1)),
    "'fields.given'|missing": lambda header, arrays: arrays.update({"fields.given": arrays["fields.forced"]}),
    "must be whole numbers": part("flow", "per_cell", value=text(0)),
    "4.0 Gauss points of a cell": part("flow", "per_cell", value=text(4.0)),
    "per cell = 7": part("flow", "per_cell", value=text(7)),
    "are no cells of 4": array("fields.flow.moduli", lambda a: a[:-1]),
    "dimension 4 must be": part("fields", "dimension", value=text(4)),
    "gradients has shape .*components = 6": part("fields", "dimension", value=text(3)),
    "first amplitude must be": entry("fields.amplitudes.constant", 0, 2.0),
    "the amplitudes are": array("amplitudes0.positions", lambda a: a[:-1]),
    "1 laws for 2 groups": lambda header, arrays: header["laws"].pop(),
    "each must have a flow": lambda header, arrays: header["laws"].__setitem__(1, TOY),
    "Plasticity refuses": number("laws", yield_stress=-1.0),
    "names .'F'.* correct the formula": number("laws", yield_stress="F"),
    "law 0: .* refuses": number("laws", yield_stress="P1 - 300"),
    "has conditions outside": array("outputs0.conditions", lambda a: a + 1000),
    "a .* has the fields": lambda header, arrays: arrays.pop("outputs0.conditions"),
    "arrays of sizes that do not fit": array("outputs0.areas", lambda a: a[:-1]),
    "trained range ends below": array("trained.parameters.upper", lambda a: a - 1e6),
    "it was trained on": part("trained", "parameters", "names", value={"items": [text("P1")] * 5}),
    "trained steps take": part("trained", "steps", value={"items": [text(2.0), text(1.0)]}),
    "the imbalance, the depth": part("trained", "onset", value=text("much")),
    "the estimates of the training": part("trained", "estimate", value=text(-1.0)),
    "header has the keys": header(more=1),
    "must be lists": header(outputs={}),
    "its tree must hold": header(tree=[]),
    "which is unknown here": part("flow", "factors", value={"kind": "Popen", "fields": {}}),
    "bounds .* must be increasing": box(upper=[0.0] * 5),
    "no formula|parameters": box(names=["P1", "h1", "gap", "w", "E"]),
}  # fmt: skip


@pytest.mark.parametrize("why", REFUSED)
def test_a_signed_file_of_other_content_is_refused_where_it_is_read(why, kept, tmp_path):
    file = tmp_path / "model.npz"
    file.write_bytes((kept / "varied.npz").read_bytes())
    rewrite_signed(file, REFUSED[why])
    with pytest.raises(ModelFileError, match=f"({why}).*build the model again"):
        hhr.load_model(file, known=[Toy])


def test_a_signed_file_that_was_not_changed_is_read(kept, tmp_path):
    """Else the tests above would pass with a wrong signature."""
    file = tmp_path / "model.npz"
    file.write_bytes((kept / "varied.npz").read_bytes())
    rewrite_signed(file, lambda header, arrays: None)
    hhr.load_model(file)
    rewrite_signed(file, header(version=99))
    with pytest.raises(ModelFileError, match="'hhr_dolfinx condensed flow model' version 99"):
        hhr.load_model(file)


def test_constant_elasticity_has_no_formulas(kept, tmp_path):
    for change, why in ((part("flow", "groups", 0, "young", value=text("P1")), "not on the part"),
                        (both(*(array(f"{name}.factors.middle", lambda a: 2 * a) for name in ("flow", "fields"))),
                         "the moduli are")):  # fmt: skip
        file = tmp_path / "model.npz"
        file.write_bytes((kept / "plain.npz").read_bytes())
        rewrite_signed(file, change)
        with pytest.raises(ModelFileError, match=why):
            hhr.load_model(file)
