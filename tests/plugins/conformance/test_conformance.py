"""Conformance checks: each passes on our parts and on toys, and says what is wrong with broken
variants of them.
"""

import importlib
import tomllib
from dataclasses import dataclass, fields, replace
from itertools import count
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from my_output import MyOutput
from needs import needs, present
from scipy.sparse import csr_matrix
from toy_functional import PressureNorm, SmoothPeak
from toy_law import Bingham
from toy_nonaffine_load import Square, WindLoad
from toy_pairing import RoundPunch
from toy_reductor import DenseCondensation, DenseElimination
from toy_system import Foundation, Parted

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx import testing as suite
from hhr_dolfinx.errors import ConformanceError, NotOfferedError, ReductionError
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.exact import ExactFields
from hhr_dolfinx.testing import LOWER_SURFACE, UPPER_SURFACE

UP = (0.0, 1.0)
NODES = hhr.NodeToNode(LOWER_SURFACE, UPPER_SURFACE, UP)
FLOOR = hhr.Obstacle(LOWER_SURFACE, UP, 1.1)
PUNCH = RoundPunch(LOWER_SURFACE, (1.5, 2.2), 1.0)
WIND = WindLoad(suite.FLANK, (1.0, 0.0), 0.5, "speed")
LOADS = {"speed": (1.0, 3.0), "height": (1.1, 1.9)}
K = {"k": (0.0, 20.0)}
KNOWN = [DenseElimination]


PASS = [
    *(
        (suite.check_pairing, part)
        for part in (
            PUNCH,
            NODES,
            FLOOR,
            *((hhr.NodeToSurface(LOWER_SURFACE, UPPER_SURFACE),) if present("nonmatching") else ()),
            *((hhr.Mortar(UPPER_SURFACE, LOWER_SURFACE),) if present("mortar") else ()),
        )
    ),
    *(
        (suite.check_load, part, LOADS)
        for part in (
            hhr.BodyForce(suite.UPPER_BODY, (0.0, -1.0), hhr.Amplitude(slopes={"load": 2.0})),
            WIND,
            hhr.Pressure(suite.FLANK, "load**2"),
            hhr.PartialPressure(suite.FLANK, hhr.Amplitude(1.0), "height"),
        )
    ),
    *(
        (suite.check_output, part)
        for part in (
            MyOutput("mean", 0, "MPa"),
            SmoothPeak("smooth", 0),
            hhr.LargestPressure("peak", 0),
            hhr.ContactForce("force", 0, UP),
            hhr.GapAt("gap", 0, (1.5, 1.0)),
            hhr.VonMises("mises", suite.UPPER_BODY),
        )
    ),
    *(
        (suite.check_system, part, K)
        for part in ((Foundation, Parted) if present("systems") else ())
    ),
    (suite.check_reductor, DenseCondensation(), KNOWN),
]


@needs("elasticity")
@pytest.mark.parametrize(
    ("check", "part", "more"), [(check, part, more) for check, part, *more in PASS]
)
def test_parts_that_keep_the_contract_pass(check, part, more):
    check(part, *more)


@needs("inelastic")
def test_laws_that_keep_the_contract_pass():
    for law in (
        Bingham(1.0, 20.0),
        lambda: hhr.Plasticity(1.0, 5.0),
        hhr.Plasticity(1.0),
        hhr.Norton(2.0, 4.0),
    ):
        suite.check_law(law)


@needs("inelastic")
def test_heat_and_moduli_of_a_law_are_no_energy_that_comes_back():
    """Swelling by 1 % in the first step, E of 2.5 times that of the body, both, and elasticity
    alone.
    """
    wood = hhr.Orthotropic(200.0, 100.0, 50.0, 0.3, 0.2, 0.1, 40.0, 30.0, 20.0)
    for law in (hhr.Plasticity(1.0, 5.0), hhr.Norton(2.0, 4.0), None):
        for change in (100.0, -100.0):
            suite.check_law(hhr.Heated(law, 1e-4, change))
            suite.check_law(hhr.ChangingStiffness(hhr.Heated(law, 1e-4, change), 500.0))
        suite.check_law(hhr.ChangingStiffness(law, 500.0))
    suite.check_law(wood)
    suite.check_law(hhr.Heated(wood, 1e-4, 100.0))


def test_parts_of_another_distribution_pass(monkeypatch):
    """Those of the external package; the gap of its ramp is a given number, below a surface that
    looks down.
    """
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "external_package"))
    parts = importlib.import_module("contact_toys.parts")
    suite.check_pairing(parts.Ramp(UPPER_SURFACE, 0.01))
    if present("inelastic"):
        suite.check_law(importlib.import_module("contact_toys.laws").Newtonian(5.0))
    with pytest.raises(
        ConformanceError, match="Ramp: forces of the size of `areas` are off a uniform pressure by"
    ):
        suite.check_pairing(parts.Ramp(LOWER_SURFACE, 0.01))


@dataclass
class Changed:
    pairing: object
    change: object

    @property
    def tags(self):
        return self.pairing.tags

    def rows(self, surfaces, dofs):
        rows = self.pairing.rows(surfaces, dofs)
        return replace(rows, **self.change(rows))


def crossed(rows):
    upper = np.isin(np.arange(rows.matrix.shape[1]) // 2, rows.slaves, invert=True)
    matrix = rows.matrix.toarray()
    return {"matrix": csr_matrix(np.where(upper, matrix[::-1], matrix))}


COUNT = count()
PAIRINGS = [
    (
        PUNCH,
        lambda rows: {"gap": 2 * rows.gap},
        "gap . grows by -2 per unit that surface 121 .* row says -1: correct",
    ),
    (NODES, lambda rows: {"matrix": -rows.matrix}, "correct one"),
    (
        FLOOR,
        lambda rows: {"areas": rows.areas / 2},
        r"uniform pressure by .*: correct areas or rows",
    ),
    (NODES, crossed, "pair each slave with the place where it lies"),
    (FLOOR, lambda rows: {"slaves": np.zeros_like(rows.slaves) - 1}, r"take `surface\.nodes`"),
    (FLOOR, lambda rows: {"areas": -rows.areas}, "an area >= 0"),
    (FLOOR, lambda rows: {"gap": rows.gap + next(COUNT)}, "the same at every call"),
    (FLOOR, lambda rows: {"gap": rows.gap[1:]}, "SceneError: contact rows need"),
]


@pytest.mark.parametrize(("pairing", "change", "said"), PAIRINGS)
def test_broken_pairings(pairing, change, said):
    with pytest.raises(ConformanceError, match=f"Changed: .*{said}"):
        suite.check_pairing(Changed(pairing, change))


CHANGES = {
    "back": (lambda stiff: -0.4, "gives back .* of the energy"),
    "softening": (lambda stiff: 1.1, r"stress falls as strain grows, by 0\.\d+ of E"),
    "never": (lambda stiff: 0.0, "nothing flows under strains of 0.02 with young = 200"),
}
"""Share of the return to a yield stress of 1 that a law makes."""


def broken(name):
    """Perfect plasticity with such a mistake."""
    share = CHANGES[name][0]

    class Broken(hhr.Law):
        def constants(self):
            return {}

        def statement(self, at):
            import ufl

            from hhr_dolfinx.forms.laws import (
                Stated,
                closed,
                deviator,
                equivalent,
                hooke,
                trace,
                unit,
            )

            if name == "never":
                return closed(at, lambda trial, stiff: ufl.max_value(-trial, 0))
            rest = hooke(deviator(at.strain - at.old.inelastic), at.constants)
            over = ufl.max_value(equivalent(rest) - 1, 0) / equivalent(rest)
            over = ufl.conditional(ufl.gt(equivalent(rest), 1), over, 0)
            whole = hooke(trace(at.strain) / 3 * unit(at.strain), at.constants)
            return Stated(
                whole + (1 - share(None) * over) * rest, {"cumulated": at.old.cumulated + over}
            )

    return Broken()


@needs("inelastic")
@pytest.mark.parametrize("name", CHANGES)
def test_broken_laws(name):
    with pytest.raises(ConformanceError, match=f"Broken: .*{CHANGES[name][1]}"):
        suite.check_law(broken(name))


def statements():
    """Laws with wrong heat, moduli or elasticity, each with the message."""
    import ufl

    from hhr_dolfinx.forms.laws import Stated, closed, equivalent, hooke, trace, unit

    def leaning(at):
        skew = ufl.as_vector([at.strain[1], 0, 0, 0])
        return Stated(hooke(at.strain, at.constants) + 2.0 * skew)

    def flowing(at, strain, young):
        """Plasticity without hardening of a strain and with an E."""
        constants = type(at.constants)(**{**vars(at.constants), "young": young})
        at = at._replace(strain=strain, constants=constants)
        return closed(at, lambda trial, stiff: ufl.max_value(trial - 1, 0) / stiff)

    def elastic_and_leaning(at):
        found = flowing(at, at.strain, at.constants.young)
        return found._replace(
            stress=found.stress + leaning(at).stress - hooke(at.strain, at.constants)
        )

    def ratchet(at):
        """Heat that strains in each step again, as `old.inelastic` has it already."""
        swollen = 5e-3 + trace(at.old.inelastic) / 3
        return flowing(at, at.strain - swollen * unit(at.strain), at.constants.young)

    def other_elasticity(at):
        """E of its own, with the inelastic strain of that of the body."""
        return flowing(at, at.strain, 3 * at.constants.young)

    def silent(at):
        """A heated law that flows, and does not state how much."""
        return flowing(at, at.strain, at.constants.young)._replace(memory={})

    def hardening_by_pressure(at):
        """A bulk modulus that grows with shear: symmetric at rest, and no derivative of an energy
        elsewhere.
        """
        more = 50 * abs(at.strain[3]) * trace(at.strain) / 3
        return Stated(hooke(at.strain + more * unit(at.strain), at.constants))

    def rooted(at):
        """A root, whose slope is no number at 0."""
        return Stated(hooke(at.strain, at.constants) * (1 + equivalent(at.strain)))

    return {
        "rooted": (rooted, "tangent without strain is no number"),
        "leaning": (leaning, "unsymmetric by 0.01 of E"),
        "elastic and leaning": (elastic_and_leaning, "unsymmetric by 0.01 of E"),
        "ratchet": (ratchet, "gives back .* of the energy"),
        "other elasticity": (other_elasticity, "gives back .* of the energy"),
        "silent": (silent, "stress depends on the path, .* never grows"),
        "by pressure": (hardening_by_pressure, "unsymmetric by"),
    }


WRONG_LAWS = [
    "rooted",
    "leaning",
    "elastic and leaning",
    "ratchet",
    "other elasticity",
    "silent",
    "by pressure",
]


@needs("inelastic")
@pytest.mark.parametrize("name", WRONG_LAWS)
def test_wrong_laws_with_heat_moduli_or_elasticity(name):
    statement, said = statements()[name]

    class Wrong(hhr.Law):
        def constants(self):
            return {}

        def statement(self, at):
            return statement(at)

    with pytest.raises(ConformanceError, match=f"Wrong: .*{said}"):
        suite.check_law(Wrong())


@needs("inelastic")
def test_a_law_that_is_no_law():
    with pytest.raises(
        ConformanceError, match=r"object: SceneError: a law of a body derives hhr\.Law"
    ):
        suite.check_law(object())
    with pytest.raises(
        ConformanceError, match=r"'yield_stress': 'sy'.* are formulas: give check_law numbers"
    ):
        suite.check_law(hhr.Plasticity("sy"))

    class Plain(hhr.Law):
        modulus: float = 1.0

    with pytest.raises(
        ConformanceError, match=r"Plain is no dataclass: write @dataclass\(frozen=True\)"
    ):
        suite.check_law(Plain())


@dataclass(frozen=True)
class Nodal:
    amplitude: object
    force: float = 1.0

    def terms(self, assembler):
        columns = np.zeros(assembler.size)
        columns[2 * assembler.surface(suite.FLANK).nodes] = self.force
        return [hhr.Term(self.amplitude, columns)]


@dataclass(frozen=True)
class WrongSquare(Square):
    def derivative(self, point):
        return self.factor * point[self.place] * np.eye(point.size)[self.place]


@dataclass(frozen=True)
class HiddenSquare(Square):
    hidden: ClassVar[float] = 1.0

    def __call__(self, point):
        columns, values = super().__call__(point)
        return columns, [self.hidden * value for value in values]


@dataclass(frozen=True)
class Wind(WindLoad):
    kind: type = Square

    def terms(self, assembler):
        ((term),) = super().terms(assembler)
        amplitude = self.kind(term.amplitude.place, term.amplitude.factor)
        if self.kind is HiddenSquare:
            amplitude.__dict__["hidden"] = 2.0
        return [hhr.Term(amplitude, term.columns)]


LOADED = [
    (
        Nodal(hhr.Amplitude(1.0)),
        r"sum up to \[5.*\] on one mesh and to \[9.*\] on a finer one: integrate a density",
    ),
    (Nodal(hhr.Amplitude(1.0), 0.0), "no force anywhere in the box"),
    (Nodal(hhr.Amplitude(1.0), np.nan), "SceneError: the nodal forces of .* are not finite"),
    (Nodal("load"), "SceneError: the amplitude 'load'"),
    (
        Wind(suite.FLANK, (1.0, 0.0), 0.5, "speed", WrongSquare),
        "`derivative` of its amplitude is not",
    ),
    (Wind(suite.FLANK, (1.0, 0.0), 0.5, "speed", HiddenSquare), "from a file answers otherwise"),
]


@pytest.mark.parametrize(("load", "said"), LOADED)
def test_broken_loads(load, said):
    with pytest.raises(ConformanceError, match=f"{type(load).__name__}: .*{said}"):
        suite.check_load(load, LOADS)


@dataclass(frozen=True, eq=False)
class OddNorm(PressureNorm):
    """Its value is another function of the one of the norm, and its slopes are as many times those
    of the norm.
    """

    changed: ClassVar[object] = staticmethod(lambda value: value)
    times: ClassVar[float] = 1.0

    def value(self, state):
        return self.changed(super().value(state))

    def slopes(self, state):
        found = super(OddNorm, replace(self)).slopes(state)  # of the value that is not changed
        return found._replace(forces=self.times * found.forces)


@dataclass(frozen=True)
class Odd(SmoothPeak):
    hidden: object = ()
    called: str = ""

    def prepared(self, probe):
        found = super().prepared(probe)
        made = OddNorm(**{item.name: getattr(found, item.name) for item in fields(found)})
        made.__dict__.update({"name": self.called or self.name} | dict(self.hidden))  # in no field
        return made


CONSTANT, DOUBLED, AGEING = (
    lambda _: 1.0,
    lambda value: 2 * value,
    lambda value: value * (1 + 1e-3 * next(COUNT)),
)
OUTPUTS = [
    (
        Odd("odd", 0, hidden={"times": 2}),
        "its derivatives are .* and differences of its value give .*: correct `slopes`",
    ),
    (
        Odd("odd", 0, hidden={"changed": CONSTANT}),
        "return a finite number that depends on the answer",
    ),
    (
        Odd("odd", 0, hidden={"changed": AGEING}),
        "a condensed model has other values than the full one",
    ),
    (Odd("odd", 0, hidden={"changed": DOUBLED, "times": 2}), "from a file answers otherwise"),
    (
        Odd("odd", 0, called="even"),
        "its functional is even in 'MPa', and the output odd in 'MPa': hand name and unit",
    ),
    (hhr.ContactForce("force", 3, UP), "SceneError: output 'force' names contact 3"),
]


@pytest.mark.parametrize(("output", "said"), OUTPUTS)
def test_broken_outputs(output, said):
    with pytest.raises(ConformanceError, match=f"{type(output).__name__}: .*{said}"):
        suite.check_output(output)


class NotExplicit(Foundation):
    def explicit(self, point, forces, unknown):
        left, slack = super().explicit(point, forces, unknown)
        left[:, self.axis] -= self.mass @ unknown
        return left, slack


class OtherParts(Parted):
    def parts(self):
        moduli, (stiffness, mass) = super().parts()
        return moduli, (stiffness, 2 * mass)


class Forgetful(Parted):
    """Its parts are read when the model is built, and never again."""

    read = False

    def parts(self):
        read, self.read = self.read, True
        return None if read else super().parts()


class Leaning(Foundation):
    def equations(self, point, theta):
        problem, stiffness, loads = super().equations(point, theta)
        matrix = stiffness.matrix.copy()
        matrix.data[1] *= 1.01
        return problem, self.made(matrix, problem), loads


class Piling(Foundation):
    def equations(self, point, theta):
        problem, stiffness, loads = super().equations(point, theta)
        return problem, stiffness, loads * (1 + 1e-9 * next(COUNT))


SYSTEMS = {
    NotExplicit: "`explicit` is not the derivative of `equations` along k",
    OtherParts: "states parts, and K of its equations differ from their sum",
    Forgetful: "it has no parts.. and is reduced all the same",
    Leaning: "is not symmetric",
    Piling: "other equations after another one",
}


@needs("systems")
@pytest.mark.parametrize("system", SYSTEMS)
def test_broken_systems(system):
    with pytest.raises(ConformanceError, match=f"{system.__name__}: .*{SYSTEMS[system]}"):
        suite.check_system(system, K)


@dataclass(frozen=True)
class Steep(DenseElimination):
    def _changes(self, *given):
        return tuple(2 * part for part in super()._changes(*given))


@dataclass(frozen=True)
class Softer(DenseElimination):
    """Its compliance is larger where it is made than in a file."""

    factor: ClassVar[float] = 1.0

    def __call__(self, point):
        found = super().__call__(point)
        return replace(found, schur=self.factor * found.schur) if self.factor != 1 else found


@dataclass(frozen=True)
class Bounded(ExactFields):
    """Not exact, and says that nothing is off."""

    exact = False


@dataclass(frozen=True)
class Rough(Bounded):
    """Not exact, and says nothing of errors."""

    def estimate(self, answer):
        return None


@dataclass(frozen=True)
class Variant:
    """The toy with another elimination, other fields, and S times a factor."""

    eliminated: type = DenseElimination
    fields: type = ExactFields
    factor: float = 1.0
    refuses: bool = True

    def reduced(self, full, snapshots, held_out):
        if full.problem.varies and self.refuses:
            raise NotOfferedError("constant stiffness only")
        problem = (
            replace(full.problem)
            if not full.problem.varies
            else full.problem.at(full.problem.middle)
        )
        alike = type(
            "Full", (), {"problem": problem, "functionals": None, "parameters": full.parameters}
        )
        made = DenseCondensation().reduced(alike, snapshots, held_out)
        values = {
            name: getattr(made.eliminated, name) for name in DenseElimination.__dataclass_fields__
        }
        values["inverse"] = self.factor * values["inverse"]
        fields = self.fields(
            **{name: getattr(made.fields, name) for name in ExactFields.__dataclass_fields__}
        )
        eliminated = self.eliminated(**values)
        if self.eliminated is Softer:
            eliminated.__dict__["factor"] = 1 + 1e-9
        return CondensedModel(
            full.parameters, eliminated, made.known, fields, problem.contact_pairs
        )


REDUCTORS = [
    (
        Variant(refuses=False),
        "its model calls itself exact and is off by .* young = .*: claim less, or refuse",
    ),
    (Variant(factor=1.001), "its model calls itself exact and is off by"),
    (Variant(factor=1.001, fields=Bounded), "its model says a bound of .* and the error is .*"),
    (Variant(factor=1.5, fields=Rough), "its model promises 0.05 and is off by"),
    (Variant(Steep), "the gradient of its forces is not what differences give"),
    (Variant(Softer), "from a file answers otherwise"),
    (DenseCondensation(most=3), "ValueError: .* dofs are more than 3"),
]


@needs("elasticity")
@pytest.mark.parametrize(("reductor", "said"), REDUCTORS)
def test_broken_reductors(reductor, said):
    with pytest.raises(ConformanceError, match=f"{type(reductor).__name__}: .*{said}"):
        suite.check_reductor(reductor, [DenseElimination, Steep, Softer, Rough, Bounded])


@needs("elasticity")
def test_a_reductor_that_promises_less_passes():
    suite.check_reductor(Variant(factor=1.001, fields=Rough), [DenseElimination, Rough])
    with pytest.raises(ConformanceError, match=r"Nothing: ReductionError: .* must return a model"):
        suite.check_reductor(type("Nothing", (), {"reduced": lambda *_: None})())
    assert issubclass(ConformanceError, AssertionError) and not issubclass(
        ConformanceError, ReductionError
    )


TEMPLATES = Path(__file__).parents[3] / "extension_templates"
NEEDED = {
    "law": ["inelastic"],
    "system": ["systems"],
    "contact_law": ["contact_laws"],
    "gasket": ["contact_laws"],
}
FOLDERS = sorted(path.parent.name for path in TEMPLATES.glob("*/pyproject.toml"))


@needs("elasticity")
@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=needs(*NEEDED[kind])) if kind in NEEDED else kind
        for kind in FOLDERS
    ],
)
def test_templates_work_as_they_are(kind, monkeypatch):
    folder = TEMPLATES / kind
    monkeypatch.syspath_prepend(str(folder))
    own = vars(importlib.import_module(f"my_{kind}"))
    every = {**registry.installed(), f"my_{kind}": own["PLUGIN"]}
    monkeypatch.setattr(registry, "installed", lambda: every)
    for cached in (registry.facet, registry.memories):
        cached.cache_clear()
    tests = vars(importlib.import_module(f"test_my_{kind}"))
    ran = [test() for name, test in [*tests.items()] if name.startswith("test_")]
    assert ran and "TODO" in (folder / f"my_{kind}.py").read_text()
    project = tomllib.loads((folder / "pyproject.toml").read_text())
    assert project["tool"]["setuptools"]["py-modules"] == [f"my_{kind}"]
    plugin = registry.load(project["project"]["entry-points"][registry.GROUP][f"my_{kind}"])
    assert isinstance(plugin, registry.Plugin) and plugin.name == f"my_{kind}"
    places = [place for named in plugin.parts.values() for place in named.values()]
    places += [
        f"{module}:{name}" for module, name in (*plugin.public.items(), *plugin.classes.items())
    ]
    assert places and all(registry.load(place) is own[place.partition(":")[2]] for place in places)


def test_there_is_a_template_for_each_seam():
    assert FOLDERS == [
        "contact_law",
        "gasket",
        "law",
        "load",
        "output",
        "pairing",
        "reductor",
        "system",
    ]
