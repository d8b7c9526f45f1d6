"""Behaviours of MFront as laws of bodies, by a stand-in for MGIS, beside laws in UFL and plasticity
in numpy.
"""

import pickle
import re
import sys
from pathlib import Path

import mgis_stand_in as stand_in
import numpy as np
import outside_laws as outside
import pytest
from condensing import QUIET, TIGHT, apart, up, walled_tube

import hhr_dolfinx as hhr
from hhr_dolfinx.by_name import names
from hhr_dolfinx.errors import ConvergenceError, MissingPackageError, SceneError
from hhr_dolfinx.plugins.inelastic.update import Group, Material

LIBRARY = "src/libBehaviour.so"
CONSTANTS = {"YieldStress": outside.YIELD, "HardeningSlope": outside.SLOPE}


@pytest.fixture(autouse=True)
def mgis(monkeypatch):
    modules = {}
    stand_in.installed(modules)
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)


def plasticity(**constants):
    return hhr.MFront(LIBRARY, "Plasticity", CONSTANTS | constants, rated=False)


def test_histories_are_those_of_the_law_in_ufl_and_what_holds_no_code_refuses(tmp_path):
    law = plasticity()
    made = outside.check_histories(law)
    outside.check_refused(*made, law, tmp_path)


def test_the_page_of_laws_has_one():
    (code,) = re.findall(
        r"```py\n(.*?)```", (Path(__file__).parents[3] / "docs/laws.md").read_text(), re.DOTALL
    )
    found = {"hhr": hhr}
    exec(code, found)
    law = found["body"].law
    assert (
        law.formulas == {"YieldStress": "80 - 0.02 * T"}
        and not law.rated
        and found["body"].reader == "inelastic"
    )


@pytest.mark.parametrize("components", [4, 6])
def test_points_beside_plasticity_in_numpy(components):
    outside.check_points(plasticity(), components)
    outside.check_points(plasticity(YoungModulus=150.0, PoissonRatio=0.3), components, young=150.0)


def test_a_behaviour_without_internal_variables():
    full = hhr.FullOrderModel(walled_tube(hhr.MFront(LIBRARY, "Elasticity")))
    assert full.equilibrium.material.rated
    found = full.march(up(0.9), TIGHT)
    expected = hhr.FullOrderModel(walled_tube(hhr.Plasticity(1e9))).march(up(0.9), TIGHT)
    assert max(apart(found, expected)) < 1e-12
    assert not found.answers[-1].plastic_strain().any()


def test_constants_and_temperature_by_formulas_of_parameters_and_places():
    """Temperatures begin at 293.15, and move in steps.

    Derivatives of a history are those of the law in UFL.
    """
    around = hhr.Plasticity("s * (1 - 0.1 * r)", "H")
    box = {"T": (200.0, 900.0), "s": (0.5, 1.5), "H": (1.0, 10.0)}
    constants = {"Temperature": "T", "YieldStress": "s * (1 - 0.1 * r)", "HardeningSlope": "H"}
    laws = hhr.Heated(around, stand_in.EXPANSION, "T", 293.15), plasticity(**constants)
    fulls = [hhr.FullOrderModel(walled_tube(law, **box)) for law in laws]
    path = [
        (time, np.array([*point, 293.15 + 3000 * time**2, 0.8, 6.0]))
        for time, point in up(0.9, dt=0.05)
    ]
    settings = hhr.MarchSettings(
        "tangent", relative_stress=1e-12, relative_force=1e-12, gradient=True
    )
    expected, found = (full.march(path, settings) for full in fulls)
    assert (
        max(apart(found, expected, outside.FIELDS)) < 1e-12
        and found.answers[-1].plastic_strain().max() > 1e-3
    )
    for one, other in zip(found.answers, expected.answers, strict=True):
        right = other.gradient.unknown
        assert np.abs(one.gradient.unknown - right).max() < 1e-7 * np.abs(right).max()
    law = plasticity(**constants).at_points(4).with_numbers({"HardeningSlope": 2.0})
    assert pickle.loads(pickle.dumps(law)).values == law.values == ("s * (1 - 0.1 * r)", 2.0, "T")
    with pytest.raises(
        SceneError, match="HardeningSlope = nan of Plasticity here must be a number"
    ):
        law.with_numbers({"HardeningSlope": float("nan")}, " here")
    with pytest.raises(SceneError, match="'YieldStres'"):
        hhr.FullOrderModel(walled_tube(plasticity(YieldStres=1.0)))
    with pytest.raises(SceneError, match=r"names \['x'\]"):
        hhr.FullOrderModel(walled_tube(plasticity(YieldStress="x * 2")))


def test_points_that_fail_cut_the_step_and_are_named():
    full = hhr.FullOrderModel(walled_tube(plasticity()))
    once = [up(0.9)[0], up(0.9)[-1]]
    largest = stand_in.LARGEST
    exact = full.march(once, QUIET)
    assert exact.answers[-1].parts == 1
    try:
        stand_in.LARGEST = 0.5 * np.abs(exact.answers[-1].stress()).max() / 200.0
        cut = full.march(once, QUIET)
        assert cut.answers[-1].converged and cut.answers[-1].parts > 1
        stand_in.LARGEST = 1e-7
        with pytest.raises(
            ConvergenceError,
            match=r"Plasticity has no answer at \d+ points, such as for the strain \(",
        ):
            full.march(once, QUIET)
    finally:
        stand_in.LARGEST = largest
    material = Material([Group(np.arange(5), 200.0, 0.3, plasticity().at_points(4))], 4)
    strain = np.zeros((5, 4))
    strain[3, 0] = 2 * largest
    with pytest.raises(
        ConvergenceError, match=r"no answer at 1 points, such as for the strain \(0\.06, 0, 0, 0\)"
    ):
        material.update(strain, material.at_rest(), 1.0, tangent=True)
    # as for programs, a strain that is no number is no point without an answer: others end the
    # iteration
    strain[3, 0] = np.nan
    assert np.isnan(material.update(strain, material.at_rest(), 1.0, tangent=True).stress[3]).any()


def test_stores_know_the_library_and_the_constants(tmp_path):
    library = tmp_path / "libBehaviour.so"
    library.write_text("one")
    outside.check_store(
        *(hhr.MFront(library, "Plasticity", CONSTANTS | {"HardeningSlope": h}) for h in (5.0, 6.0)),
        tmp_path / "constants",
    )
    law = hhr.MFront(library, "Plasticity", CONSTANTS)
    library.write_text("two")
    outside.check_store(law, hhr.MFront(library, "Plasticity", CONSTANTS), tmp_path / "libraries")


@pytest.mark.parametrize(
    ("library", "behaviour", "constants", "why"),
    [
        (
            LIBRARY,
            "Plasticity",
            {"YieldStress": 1.0},
            r"\['HardeningSlope'\] are missing in its constants",
        ),
        (LIBRARY, "Plasticity", {**CONSTANTS, "Y": 1.0}, r"\['Y'\] are unknown"),
        (LIBRARY, "Finite", {}, "Finite of src/libBehaviour.so must be of small strains"),
        (LIBRARY, "Tensorial", {}, "numbers as external state variables"),
        (
            LIBRARY,
            "Other",
            {},
            r"MGIS cannot load Other of .* for .*PlaneStrain: .*Other_mfront_mkt",
        ),
        ("nothing.so", "Plasticity", CONSTANTS, "library 'nothing.so' could not be loaded"),
    ],
)
def test_what_is_no_law_of_a_body_is_refused(library, behaviour, constants, why):
    with pytest.raises(SceneError, match=why):
        hhr.FullOrderModel(walled_tube(hhr.MFront(library, behaviour, constants)))
    with pytest.raises(SceneError, match="must be a number"):
        hhr.MFront(library, behaviour, {"YieldStress": float("nan")})


def test_without_mgis_the_error_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "mgis", None)
    monkeypatch.delitem(sys.modules, "mgis.behaviour")
    assert names("laws")["MFront"] == "mfront"
    scene = walled_tube(hhr.MFront("src/libBehaviour_elsewhere.so", "Plasticity", CONSTANTS))
    with pytest.raises(
        MissingPackageError, match=r"needs mgis\.behaviour.*conda install -c conda-forge mgis"
    ):
        hhr.FullOrderModel(scene)
