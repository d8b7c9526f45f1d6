"""Constants of laws that are formulas of the parameters: the same bits, cut steps, what is refused,
ends of tables.
"""

import dataclasses
from typing import Literal

import numpy as np
import pytest
import ufl
import varied
from flow_histories import whole_history
from history_bits import flat
from needs import needs
from processes import python
from toy_law import Bingham
from tubes import YOUNG
from varied import path
from yielding_scenes import axial, bar

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ConvergenceError, SceneError, SceneWarning
from hhr_dolfinx.forms.laws import closed
from hhr_dolfinx.plugins.inelastic.constants import LawOfParameters, formulas_of
from hhr_dolfinx.plugins.inelastic.history_gradient import history_gradient
from hhr_dolfinx.plugins.inelastic.law import program_of
from hhr_dolfinx.plugins.inelastic.update import Material

QUIET = hhr.MarchSettings(outside="ignore")
TIGHT = hhr.MarchSettings(
    "tangent", relative_stress=1e-10, floor_stress=1e-9, relative_force=1e-12, outside="ignore"
)
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
    assert (
        all("('E', 'w', 'H', 'K')" in text and "law or shape names them" in text for text in said)
        and len(said) == 2
    )
    assert same(full.march(path()), numbers.march(path()))
    assert same(others.march(path()), numbers.march(path()))


@needs("nonmatching")
def test_a_step_has_the_constants_of_its_end(full):
    """Only the last step is weaker: those before are those of the strong body, bit for bit."""
    strong, mixed = path(), [*path()[:-1], path(hardening=600.0)[-1]]
    one, other = full.march(strong).answers, full.march(mixed).answers
    assert all(
        np.array_equal(a.gauss.stress, b.gauss.stress)
        for a, b in zip(one[:-1], other[:-1], strict=True)
    )
    assert other[-1].plastic_strain().max() > one[-1].plastic_strain().max() * 1.001


def test_a_bar_follows_its_yield_stress():
    """Held at a strain and heated, the stress relaxes to the yield stress.

    Cooled, it stays where it was.
    """
    temperatures = np.array([20.0, 20.0, 20.0, 300.0, 600.0, 310.0, 20.0])
    pulls = np.array([0.0, 0.002, 0.02, 0.02, 0.02, 0.02, 0.02])
    path = [
        (float(k), np.array(point)) for k, point in enumerate(zip(pulls, temperatures, strict=True))
    ]
    full = hhr.FullOrderModel(bar(hhr.Plasticity("table(T, 20, 1.0, 300, 0.9, 600, 0.5)"), T=WARM))
    expected = [YOUNG * 0.002, 1.0, 0.9, 0.5, 0.5, 0.5]
    assert axial(full.march(path, TIGHT)) == pytest.approx(expected, rel=1e-6)


@dataclasses.dataclass(frozen=True)
class Patient(hhr.Law):
    """Perfect plasticity that gives up in long steps, in words of its own."""

    threshold: float | str
    longest: float
    word: str = "T"
    style: Literal["T"] = "T"

    def statement(self, at):
        c = at.constants
        found = closed(at, lambda trial, stiff: ufl.max_value(trial - c.threshold, 0) / stiff)
        return found._replace(limit=c.longest - at.dt, reason="the step is too long")


def test_parts_of_a_step_have_constants_of_their_own():
    """A step that is cut is the same as its parts asked for one by one: the parameter is linear
    along it.
    """
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
    law = program_of(Patient("2 * T", 1.0), 4)
    assert law.formulas == formulas_of(Patient("2 * T", 1.0)) == {"threshold": "2 * T"}
    assert LawOfParameters(law, ("pull", "T")).at(np.array([0.0, 30.0])).values == (60.0, 1.0)
    assert formulas_of(None) == {}


def test_laws_of_numbers_load_no_formulas():
    program = (
        "import sys, numpy as np\n"
        "from hhr_dolfinx.plugins.inelastic import law, laws, update\n"
        "group = update.Group(np.arange(2), 1.0, 0.3, law.program_of(laws.Plasticity(1.0), 4))\n"
        "material = update.Material([group], 4, ('p',)).at(np.zeros(1))\n"
        "material.update(np.zeros((2, 4)), material.at_rest(), 1.0, tangent=True)\n"
        "assert 'hhr_dolfinx.formulas' not in sys.modules\n"
    )
    python("-c", program)


@needs("nonmatching")
def test_the_whole_basis_gives_the_full_history(full):
    """With constants that change along the path."""
    weaker = [
        (time, point - [0, 0, 0, 0, 0, 0, 10.0 * time, 100.0 * time]) for time, point in path()
    ]
    whole_history(full, weaker, TIGHT)


@needs("nonmatching")
def test_a_law_of_a_users_own_takes_formulas_and_travels(tmp_path):
    """A file keeps it without its class, and its constants as formulas."""
    with pytest.warns(SceneWarning, match=r"\('E', 'w', 'H'\)"):
        one, other = (
            pellet(law) for law in (Bingham("T / 10 + 80", 0.0), hhr.Plasticity("T / 10 + 80"))
        )
    histories = [full.march(path(), TIGHT) for full in (one, other)]
    stress = [history.answers[-1].stress() for history in histories]
    assert stress[0] == pytest.approx(stress[1], abs=1e-8 * np.abs(stress[1]).max())
    reduced = varied.reduced()
    groups = list(reduced.flow.material.groups)
    groups[0] = dataclasses.replace(groups[0], law=one.equilibrium.material.groups[0].law)
    material = Material(groups, 4, reduced.parameters.names)
    flow = dataclasses.replace(reduced.flow, material=material)
    hhr.save_model(tmp_path / "model.npz", reduced.changed(flow=flow))
    loaded = hhr.load_model(tmp_path / "model.npz")
    assert loaded.flow.material.groups[0].law.values == ("T / 10 + 80", 0.0)
    assert same(loaded.march(path(), QUIET), reduced.changed(flow=flow).march(path(), QUIET))


# what cannot be


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (
            hhr.Plasticity("sx"),
            r"names \['sx'\], and the parameters are \('pull', 'T'\): correct the formula",
        ),
        (
            hhr.Plasticity("1 - T / 500"),
            (
                "yield_stress = -.* of Plasticity at pull = .*, by yield_stress = 1 - T / 500, "
                "must be a number above 0"
            ),
        ),
        (
            hhr.Plasticity(1.0, "T - 21"),
            r"hardening = -1.0 of Plasticity at .*T = 20.* must be a number at least",
        ),
        (hhr.Norton(1.0, "20 / T"), r"exponent = .* of Norton at .* must be a number at least 1"),
        (
            hhr.Plasticity("table(T, 20, 1, 500, 2)"),
            r"outside the table from 20 to 500.*further points, or narrow",
        ),
        (
            Bingham("log(T - 100)", 1.0),
            r"yield_stress = log\(T - 100\) of Bingham is nan at .*: change the formula",
        ),
        (
            hhr.Plasticity("(-8) ** 0.5"),
            r"yield_stress = .* of Plasticity is nan at .*: change the formula",
        ),
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
