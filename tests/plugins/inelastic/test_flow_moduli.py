"""Young's moduli that are formulas, and strains without stress, where bodies flow: closed forms,
what is refused.
"""

import dataclasses

import numpy as np
import pytest
import varied
from condensing import EVERY, QUIET, TIGHT, apart, condensed
from needs import needs
from scenes import pressed_pair, slope
from tubes import YOUNG
from yielding_scenes import MATERIALS, axial, bar, blocks, glued, pressed, push

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries import block, pellet_cladding, two_blocks
from hhr_dolfinx.loads import Term
from hhr_dolfinx.plugins.inelastic.law import program_of
from hhr_dolfinx.plugins.inelastic.update import Group, Material

NEWTON = hhr.MarchSettings(
    "tangent", relative_stress=1e-10, floor_stress=1e-9, relative_force=1e-12, outside="ignore"
)
HEAT = (
    hhr.ThermalExpansion(two_blocks.FIRST, 1e-4, "T", field=lambda x: 1 + x[0] * x[1]),
    hhr.Eigenstrain(
        two_blocks.SECOND,
        hhr.Amplitude(0.001, {"T": 5e-5}),
        ((1.0, 0.3, 0), (0.3, 2.0, 0), (0, 0, 0.5)),
    ),
)


@pytest.mark.parametrize(
    ("make", "formulas", "numbers", "path", "point", "other", "parts"),
    [
        (blocks, ("E1", "2 * E2"), (3.7, 6.2), push, (3.7, 3.1), (2.7, 3.1), 2),
        (glued, ("E1", "E2"), (3.7, 6.2), pressed, (3.7, 6.2), (2.1, 2.2), None),
        (glued, ("E1", "E1"), (3.7, 3.7), pressed, (3.7,), (2.1,), 1),
    ],
    ids=[
        "in space, where a load imposes displacements",
        "bodies that hang together",
        "a common formula",
    ],
)
def test_formulas_of_moduli_are_the_numbers(make, formulas, numbers, path, point, other, parts):
    """Bodies that hang together are factored anew, also while factors of another point are at
    hand.
    """
    box = {name: MATERIALS[name] for name in ("E1", "E2")[: len(point)]}
    varying, plain = (
        hhr.FullOrderModel(make(*formulas, materials=box)),
        hhr.FullOrderModel(make(*numbers, materials={})),
    )
    assert parts == (None if varying.system.bodies is None else len(varying.problem.moduli))
    for search in ("frozen", "elastic"):
        settings = hhr.MarchSettings(search, iterations=300)
        expected = plain.march(path(), settings)
        for _ in range(2):
            assert max(apart(varying.march(path(*other), settings), expected)) > 1e-3
            one = varying.march(path(*point), settings)
            assert (
                one.answers[-1].plastic_strain().max() > 1e-3 and one.answers[-1].forces().max() > 0
            )
            assert max(apart(one, expected, EVERY)) < 1e-10


def test_what_is_not_built_in():
    law = hhr.Plasticity(1.0)
    assert hhr.Body(1, "E", 0.3, law).varies
    material = Material([Group(np.arange(1), "E", 0.3, program_of(law, 4))], 4, ("E",))
    for ask in (
        lambda: material.elastic,
        lambda: material.update(np.ones((1, 4)), material.at_rest(), 1.0, tangent=False),
    ):
        with pytest.raises(
            SceneError,
            match=r"young = E is a formula of the parameters: material.moduli_at\(point\)",
        ):
            ask()
    with pytest.raises(SceneError, match=r"young = E is -1 at E = -1: .* Change the formula"):
        material.moduli_at(np.array([-1.0]))
    creeping = Material(
        [Group(np.arange(1), 1.0, 0.3, program_of(hhr.Norton("K", 2.0), 4))], 4, ("K",)
    )
    with pytest.raises(
        SceneError, match=r"'K' of Norton is a formula of the parameters: material.at\(point\)"
    ):
        creeping.update(np.ones((1, 4)), creeping.at_rest(), 1.0, tangent=False)
    with pytest.raises(SceneError, match="names"):
        Material([Group(np.arange(1), "F", 0.3, program_of(law, 4))], 4, ("E",))


@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric", "solid"])
def test_where_nothing_flows_it_is_the_elastic_scene(hypothesis):
    """Nearly incompressible, so that elastic bodies too take the mean dilatation: to round-off,
    measured 1e-14.
    """

    def heated(law, young="4 * w"):
        bodies = (
            hhr.Body(two_blocks.FIRST, 3.0, 0.46, law),
            hhr.Body(two_blocks.SECOND, young, 0.46),
        )
        pressure = hhr.Pressure(two_blocks.side(two_blocks.SECOND, 0, True), slope("load"))
        space = {"T": (0.0, 100.0), "w": (0.5, 2.0)}
        return hhr.FullOrderModel(
            pressed_pair(hypothesis, bodies, space, cells=2, loads=(HEAT[0], pressure, HEAT[1]))
        )

    point = {"push": 0.03, "slide": 0.01, "load": 0.05, "gap": 0.001, "T": 80.0, "w": 1.3}
    one, other = heated(None).solve(point), heated(hhr.Plasticity(1e6)).solve(point)
    for name in ("displacement", "forces"):
        assert relative_error(getattr(other, name)(), getattr(one, name)()) < 1e-12
    assert one.forces().max() > 0 and other.plastic_strain().max() == 0


def warm_bar(law, young=YOUNG, **space):
    """The bar held at its ends and heated."""
    heat = hhr.ThermalExpansion(block.SOLID, "1e-5 * (1 + T / 900)", "T")
    return hhr.FullOrderModel(bar(law, young=young, loads=(heat,), T=(0.0, 900.0), **space))


def expansion(temperature):
    return 1e-5 * (1 + temperature / 900) * temperature


@pytest.mark.filterwarnings("ignore:no training solution has contact")
def test_a_bar_that_is_held_and_heated_yields():
    """σ = -E ε0 up to the yield stress; cooled, it is left with tension.

    E is a number, or a parameter.
    """
    temperatures = np.array([0.0, 200.0, 600.0, 900.0, 700.0, 0.0])
    flowed = expansion(900.0) - 1.0 / YOUNG
    expected = [-YOUNG * expansion(200.0), -1.0, -1.0, YOUNG * (flowed - expansion(700.0)), 1.0]

    def heated(*young):
        return [(float(k), np.array([0.0, heat, *young])) for k, heat in enumerate(temperatures)]

    varying = warm_bar(hhr.Plasticity(1.0), "E", E=(0.5 * YOUNG, 3 * YOUNG))
    assert axial(warm_bar(hhr.Plasticity(1.0)).march(heated(), NEWTON)) == pytest.approx(
        expected, rel=1e-7
    )
    assert axial(varying.march(heated(YOUNG), NEWTON)) == pytest.approx(expected, rel=1e-7)
    model = condensed(
        varying, [varying.march(heated(young), TIGHT) for young in (0.8 * YOUNG, 2 * YOUNG)]
    )
    assert axial(model.march(heated(YOUNG), QUIET)) == pytest.approx(expected, rel=1e-4)


def test_free_expansion_flows_nowhere():
    """The bar follows its own strain, whatever its law."""
    full = warm_bar(hhr.Norton(1.0, 3.0))
    path = [
        (float(k), np.array([expansion(heat), heat])) for k, heat in enumerate((0.0, 300.0, 900.0))
    ]
    history = full.march(path)
    assert max(np.abs(answer.stress()).max() for answer in history.answers) < 1e-12 * YOUNG
    radial = history.answers[-1].displacement().reshape(-1, 2)[:, 0]
    assert radial == pytest.approx(
        full.problem.points[:, 0] * expansion(900.0), rel=1e-9, abs=1e-15
    )


@dataclasses.dataclass(frozen=True)
class Own:
    """A strain of a user's own that makes no term of what it is given."""

    tag: int
    amplitude = slope("T")

    def terms(self, assembler):
        return [Term(self.amplitude, np.ones(assembler.size))]

    def eigenstrain_of(self, tag, mesh):
        return hhr.Eigenstrain(self.tag, self.amplitude).eigenstrain_of(tag, mesh)


@needs("nonmatching")
def test_a_strain_of_a_users_own_must_have_its_term():
    with pytest.raises(
        SceneError, match="must have the one term that its assembler's eigenstress gives"
    ):
        hhr.FullOrderModel(varied.scene(loads=[Own(pellet_cladding.PELLET)]))
