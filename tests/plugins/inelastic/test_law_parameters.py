"""Constants of laws that are formulas of the parameters: the same bits, cut steps, what is refused, ends of tables."""

import dataclasses
from typing import Literal

import numpy as np
import pytest
import varied
from bare import python
from marched import flat
from needs import needs
from test_plastic import axial, bar, whole_history
from tubes import YOUNG
from varied import path

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ConvergenceError, ModelFileError, SceneError, SceneWarning
from hhr_dolfinx.plugins.inelastic.constants import formulas_of, law_at
from hhr_dolfinx.plugins.inelastic.history_gradient import history_gradient

TIGHT = hhr.MarchSettings("tangent", relative_stress=1e-10, floor_stress=1e-9, relative_force=1e-12, outside="ignore")
YOUNGS = 190e3, 78e3
WARM = (20.0, 600.0)


def pellet(plastic=varied.LAWS[0], creep=varied.LAWS[1]):
    """The small flowing pellet with moduli that are numbers."""
    return hhr.FullOrderModel(varied.scene(YOUNGS, (plastic, creep)))


def same(one, other):
    return flat(one).tobytes() == flat(other).tobytes()


@pytest.fixture(scope="module")
def full():
    with pytest.warns(SceneWarning, match="E"):
        return pellet()


@needs("nonmatching")
def test_formulas_of_constants_are_the_constants(full):
    """To the last bit, with and without a parameter."""
    with pytest.warns(SceneWarning) as caught:
        numbers = pellet(hhr.Plasticity("90 - 0.02 * T", 1e3), hhr.Norton(1e3, 4.0))
        others = pellet(hhr.Plasticity("80 + 10 - T / 50", "1e3"), hhr.Norton("10 ** 3", "2 * 2"))
    said = [str(item.message) for item in caught]
    # no parameter is idle that a law names
    assert all("('E', 'w', 'H', 'K')" in text and "law or shape names them" in text for text in said) and len(said) == 2
    assert same(full.march(path()), numbers.march(path()))
    assert same(others.march(path()), numbers.march(path()))


@needs("nonmatching")
def test_a_step_has_the_constants_of_its_end(full):
    """Only the last step is weaker: those before are those of the strong body, bit for bit."""
    strong, mixed = path(), [*path()[:-1], path(hardening=600.0)[-1]]
    one, other = full.march(strong).answers, full.march(mixed).answers
    assert all(np.array_equal(a.gauss.stress, b.gauss.stress) for a, b in zip(one[:-1], other[:-1], strict=True))
    assert other[-1].plastic_strain().max() > one[-1].plastic_strain().max() * 1.001


def test_a_bar_follows_its_yield_stress():
    """Held at a strain and heated, the stress relaxes to the yield stress; cooled, it stays where it was."""
    temperatures = np.array([20.0, 20.0, 20.0, 300.0, 600.0, 310.0, 20.0])
    pulls = np.array([0.0, 0.002, 0.02, 0.02, 0.02, 0.02, 0.02])
    path = [(float(k), np.array(point)) for k, point in enumerate(zip(pulls, temperatures, strict=True))]
    full = hhr.FullOrderModel(bar(hhr.Plasticity("table(T, 20, 1.0, 300, 0.9, 600, 0.5)"), T=WARM))
    expected = [YOUNG * 0.002, 1.0, 0.9, 0.5, 0.5, 0.5]
    assert axial(full.march(path, TIGHT)) == pytest.approx(expected, rel=1e-6)


@dataclasses.dataclass(frozen=True)
class Patient:
    """Perfect plasticity that gives up in long steps, in words of its own."""

    threshold: float | str
    longest: float
    name: str = "T"
    style: Literal["T"] = "T"
    rates: tuple[float, ...] = (1.0,)

    def flow(self, trial, plastic_strain, shear, dt):
        if dt > self.longest:
            raise ArithmeticError("too long")
        return hhr.Plasticity(self.threshold).flow(trial, plastic_strain, shear, dt)


def test_parts_of_a_step_have_constants_of_their_own():
    """A step that is cut is the same as its parts asked for one by one: the parameter is linear along it."""
    full = hhr.FullOrderModel(bar(Patient("1 - (T / 1000) ** 2", 0.3), T=WARM))
    coarse = [(float(k), np.array([0.02 * k, 20.0 + 290.0 * k])) for k in range(3)]
    fine = [(k / 4, np.array([0.005 * k, 20.0 + 72.5 * k])) for k in range(9)]
    history = full.march(coarse, TIGHT)
    assert history.cuts == 2
    assert axial(history) == pytest.approx(axial(full.march(fine, TIGHT))[3::4], rel=1e-9)
    assert axial(history) == pytest.approx([1 - 0.31**2, 1 - 0.6**2], rel=1e-6)
    with pytest.raises(ConvergenceError, match="step 1 of the history was solved in parts"):
        history_gradient(full.equilibrium, history)


def test_words_of_a_law_are_no_formulas():
    """Only what may be a float; the word T stays a word although a parameter has its name."""
    law = Patient("2 * T", 1.0)
    assert formulas_of(law) == {"threshold": "2 * T"}
    assert law_at(law, ("pull", "T"), np.array([0.0, 30.0])) == Patient(60.0, 1.0)
    assert law_at(law_at(law, ("T",), np.array([3.0])), (), np.zeros(0)) == Patient(6.0, 1.0)
    assert formulas_of(dataclasses.make_dataclass("Local", [("x", "Unknown")], frozen=True)("T")) == {}
    assert formulas_of(Patient) == formulas_of(None) == formulas_of("sy") == {}


def test_laws_of_numbers_load_no_formulas():
    program = (
        "import sys, numpy as np\n"
        "from hhr_dolfinx.plugins.inelastic import laws, update\n"
        "group = update.Group(np.arange(2), 1.0, 0.3, laws.Plasticity(1.0))\n"
        "material = update.Material([group], 4, ('p',)).at(np.zeros(1))\n"
        "material.update(np.zeros((2, 4)), material.at_rest(), 1.0, tangent=True)\n"
        "assert 'hhr_dolfinx.formulas' not in sys.modules\n"
    )
    python("-c", program)


@needs("nonmatching")
def test_the_whole_basis_gives_the_full_history(full):
    """With constants that change along the path."""
    weaker = [(time, point - [0, 0, 0, 0, 0, 0, 10.0 * time, 100.0 * time]) for time, point in path()]
    whole_history(full, weaker, TIGHT)


@dataclasses.dataclass(frozen=True)
class Undeclared:
    """A law that says nothing of formulas, and takes them all the same."""

    threshold: float

    def flow(self, trial, plastic_strain, shear, dt):
        return hhr.Plasticity(self.threshold).flow(trial, plastic_strain, shear, dt)


@needs("nonmatching")
def test_a_law_of_a_users_own_takes_formulas(tmp_path):
    with pytest.warns(SceneWarning, match=r"\('E', 'w', 'H'\)"):
        one, other = (pellet(law("T / 10 + 80")) for law in (Undeclared, hhr.Plasticity))
    assert same(one.march(path()), other.march(path()))
    reduced = varied.reduced()
    flow = dataclasses.replace(reduced.flow, material=one.equilibrium.material.restricted(reduced.flow.points))
    with pytest.raises(ModelFileError, match=r"threshold of Undeclared is 'T / 10 \+ 80', .*declare it float \| str"):
        hhr.save_model(tmp_path / "model.npz", reduced.changed(flow=flow))


# what cannot be


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (hhr.Plasticity("sx"), r"names \['sx'\], and the parameters are \('pull', 'T'\): correct the formula"),
        (
            hhr.Plasticity("1 - T / 500"),
            r"Plasticity refuses yield_stress = 1 - T / 500 = -.* at pull = .*narrow the box",
        ),
        (hhr.Plasticity(1.0, "T - 21"), r"refuses hardening = T - 21 = -1 at .*T = 20.*narrow the box"),
        (hhr.Norton(1.0, "20 / T"), r"Norton refuses exponent = .*narrow the box"),
        (hhr.Plasticity("table(T, 20, 1, 500, 2)"), r"outside the table from 20 to 500.*further points, or narrow"),
        (Undeclared("log(T - 100)"), r"threshold = log\(T - 100\) of Undeclared is nan at .*: change the formula"),
        (hhr.Plasticity("(-8) ** 0.5"), r"yield_stress = .* of Plasticity is nan at .*: change the formula"),
        (Undeclared("T +"), r"threshold of Undeclared: the formula 'T \+' cannot be read"),
    ],
)
def test_laws_that_are_impossible_somewhere_name_their_body(law, message):
    with pytest.raises(SceneError, match=rf"body \d+ of scene 'bar': .*{message}"):
        hhr.FullOrderModel(bar(law, T=WARM))


def test_derivatives_at_the_end_of_a_table():
    """One step beyond, there is no law: differences are taken to the inside."""
    law = hhr.Plasticity("table(T, 20, 1.0, 600, 0.5) + 0 * pull", 5.0)
    model = hhr.FullOrderModel(bar(law, T=WARM)).equilibrium
    for temperature, inside in ((20.0, 1.0), (600.0, -1.0)):
        ends = []
        for h in (0.0, 0.1, 0.2):
            path = [(float(k), np.array([0.01 * k, temperature + inside * h])) for k in range(3)]
            ends.append(model.fields.march(path, TIGHT))
        start, near, far = (history.answers[-1].unknown for history in ends)
        slope = history_gradient(model, ends[0])[-1].unknown[:, 1]
        expected = inside * (4 * near - far - 3 * start) / 0.2
        assert np.abs(slope).max() > 0
        assert slope == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())
