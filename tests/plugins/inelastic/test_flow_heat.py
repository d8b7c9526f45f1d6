"""Strains without stress where bodies flow: beside elastic scenes and closed forms, reduced, in files, derivatives."""

import dataclasses

import flowing
import numpy as np
import pellet_cladding_plastic as demo
import pytest
from marched import flat
from scenes import pressed_pair
from test_plastic import bar
from tubes import YOUNG

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries import block, pellet_cladding, two_blocks
from hhr_dolfinx.loads import Term

TIGHT = hhr.MarchSettings("tangent", relative_stress=1e-10, floor_stress=1e-9, relative_force=1e-12, outside="ignore")
QUIET = hhr.MarchSettings(outside="ignore")
HEAT = (
    hhr.ThermalExpansion(two_blocks.FIRST, 1e-4, "T", field=lambda x: 1 + x[0] * x[1]),
    hhr.Eigenstrain(two_blocks.SECOND, hhr.Amplitude(0.001, {"T": 5e-5}), ((1.0, 0.3, 0), (0.3, 2.0, 0), (0, 0, 0.5))),
)


@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric", "solid"])
def test_where_nothing_flows_it_is_the_elastic_scene(hypothesis):
    """Nearly incompressible, so that elastic bodies too take the mean dilatation: to round-off, measured 1e-14."""

    def heated(law, young="4 * w"):
        bodies = hhr.Body(two_blocks.FIRST, 3.0, 0.46, law), hhr.Body(two_blocks.SECOND, young, 0.46)
        pressure = hhr.Pressure(two_blocks.side(two_blocks.SECOND, 0, True), hhr.Amplitude(slopes={"load": 1.0}))
        space = {"T": (0.0, 100.0), "w": (0.5, 2.0)}
        return hhr.FullOrderModel(pressed_pair(hypothesis, bodies, space, cells=2, loads=(HEAT[0], pressure, HEAT[1])))

    point = {"push": 0.03, "slide": 0.01, "load": 0.05, "gap": 0.001, "T": 80.0, "w": 1.3}
    one, other = heated(None).solve(point), heated(hhr.Plasticity(1e6)).solve(point)
    for name in ("displacement", "forces"):
        assert relative_error(getattr(other, name)(), getattr(one, name)()) < 1e-12
    assert one.forces().max() > 0 and other.plastic_strain().max() == 0


def warm_bar(law, young=YOUNG, **space):
    """The bar held at its ends and heated."""
    box = {"pull": (-0.1, 0.1), "T": (0.0, 900.0)} | space
    base = bar(law)
    bodies = (dataclasses.replace(base.bodies[0], young=young),)
    loads = (hhr.ThermalExpansion(block.SOLID, "1e-5 * (1 + T / 900)", "T"),)
    given = {"parameters": hhr.ParameterSpace(tuple(box), *zip(*box.values(), strict=True)), "loads": loads}
    return hhr.FullOrderModel(dataclasses.replace(base, bodies=bodies, **given))


def axial(history):
    stresses = np.array([answer.stress()[:, 1] for answer in history.answers])
    assert np.ptp(stresses, axis=1).max() < 1e-6
    return stresses[:, 0]


def expansion(temperature):
    return 1e-5 * (1 + temperature / 900) * temperature


def test_a_bar_that_is_held_and_heated_yields():
    """σ = -E ε0 up to the yield stress; cooled, it is left with tension. E is a number, or a parameter."""
    temperatures = np.array([0.0, 200.0, 600.0, 900.0, 700.0, 0.0])
    flowed = expansion(900.0) - 1.0 / YOUNG
    expected = [-YOUNG * expansion(200.0), -1.0, -1.0, YOUNG * (flowed - expansion(700.0)), 1.0]
    path = [(float(k), np.array([0.0, heat])) for k, heat in enumerate(temperatures)]
    assert axial(warm_bar(hhr.Plasticity(1.0)).march(path, TIGHT)) == pytest.approx(expected, rel=1e-7)
    varying = warm_bar(hhr.Plasticity(1.0), "E", E=(0.5 * YOUNG, 3 * YOUNG))
    path = [(time, np.append(point, YOUNG)) for time, point in path]
    assert axial(varying.march(path, TIGHT)) == pytest.approx(expected, rel=1e-7)


def test_free_expansion_flows_nowhere():
    """The bar follows its own strain, whatever its law."""
    full = warm_bar(hhr.Norton(1.0, 3.0))
    path = [(float(k), np.array([expansion(heat), heat])) for k, heat in enumerate((0.0, 300.0, 900.0))]
    history = full.march(path)
    assert max(np.abs(answer.stress()).max() for answer in history.answers) < 1e-12 * YOUNG
    radial = history.answers[-1].displacement().reshape(-1, 2)[:, 0]
    assert radial == pytest.approx(full.problem.points[:, 0] * expansion(900.0), rel=1e-9, abs=1e-15)


SPACE = hhr.ParameterSpace(
    ("P1", "h1", "gap", "T", "E"), (0.0, 0.5, 4e-3, 0.0, 150e3), (460.0, 1.5, 16e-3, 1000.0, 230e3)
)


def hot_pellet(**others):
    """The small flowing scene, whose pellet grows into its cladding."""
    base = demo.scene(**flowing.SMALL_MESH)
    bodies = dataclasses.replace(base.bodies[0], young="E"), base.bodies[1]
    heat = hhr.ThermalExpansion(pellet_cladding.PELLET, 1.2e-5, "T", field=lambda x: 1 - 0.02 * x[0] ** 2)
    return dataclasses.replace(base, **({"bodies": bodies, "parameters": SPACE, "loads": (*base.loads, heat)} | others))


def path(gap=10.0, young=190e3, heat=800.0, steps=flowing.STEPS):
    return [(time, np.append(point, (heat * time, young))) for time, point in demo.path(gap, steps)]


@pytest.fixture(scope="module")
def full():
    return hhr.FullOrderModel(hot_pellet())


@pytest.fixture(scope="module")
def reduction(full):
    histories = [full.march(path(gap, young)) for gap in flowing.TRAINING for young in (160e3, 220e3)]
    recipe = hhr.Recipe.flowing()
    return hhr.build(full, hhr.SnapshotSet.of_histories(histories), recipe.as_it_is())


def test_a_reduced_model_and_its_file(full, reduction, tmp_path):
    asked = path(9.0, 200e3)
    found, expected = reduction.march(asked, QUIET), full.march(asked)
    for one, other in zip(found.answers, expected.answers, strict=True):
        assert relative_error(one.displacement(), other.displacement()) < 2e-2
    cold = full.march(path(9.0, 200e3, 0.0))
    assert relative_error(cold.answers[-1].displacement(), expected.answers[-1].displacement()) > 0.1
    hhr.save_model(tmp_path / "model.npz", reduction)
    stored = hhr.load_model(tmp_path / "model.npz")
    assert flat(stored.march(asked, QUIET)).tobytes() == flat(found).tobytes()


@pytest.mark.parametrize("which", ["full", "reduced"])
def test_derivatives_along_the_heat(full, reduction, which):
    """Central differences of histories that are all 0.02 K warmer or colder, or 20 MPa stiffer or softer."""
    model = full if which == "full" else reduction
    base = [(time, point + np.array([0, 0, 0, 10.0, 0])) for time, point in path()]
    history = model.march(base, dataclasses.replace(TIGHT, gradient=True))
    for axis, step in ((3, 0.02), (4, 20.0)):
        shift = step * (np.arange(5) == axis)
        ends = [model.march([(time, point + sign * shift) for time, point in base], TIGHT).answers for sign in (1, -1)]
        for name in ("unknown", "multipliers"):
            found = np.stack([getattr(answer.gradient, name)[:, axis] for answer in history.answers])
            changes = np.stack([getattr(one, name) - getattr(other, name) for one, other in zip(*ends, strict=True)])
            assert np.linalg.norm(found - changes / (2 * step)) < 1e-5 * np.linalg.norm(found)


def test_a_store_tells_strains_apart(full, tmp_path):
    full.march(path(), QUIET, keep=hhr.SnapshotStore(tmp_path, full).steps(path(), QUIET).save)
    other = hhr.ThermalExpansion(pellet_cladding.PELLET, 1.2e-5, "T", field=lambda x: 1 - 0.03 * x[0] ** 2)
    changed = hhr.FullOrderModel(hot_pellet(loads=(hot_pellet().loads[0], other)))
    for model, count in ((full, flowing.STEPS), (changed, 0)):
        assert len(hhr.SnapshotStore(tmp_path, model).steps(path(), QUIET).load()) == count


@dataclasses.dataclass(frozen=True)
class Own:
    """A strain of a user's own that makes no term of what it is given."""

    tag: int
    amplitude = hhr.Amplitude(slopes={"T": 1.0})

    def terms(self, assembler):
        return [Term(self.amplitude, np.ones(assembler.size))]

    def eigenstrain_of(self, tag, mesh):
        return hhr.Eigenstrain(self.tag, self.amplitude).eigenstrain_of(tag, mesh)


def test_a_strain_of_a_users_own_must_have_its_term():
    with pytest.raises(SceneError, match="must have the one term that its assembler's eigenstress gives"):
        hhr.FullOrderModel(hot_pellet(loads=(hot_pellet().loads[0], Own(pellet_cladding.PELLET))))
