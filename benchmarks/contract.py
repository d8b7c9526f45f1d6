"""One contract: every kind of model, every verb, in every place.

What a kind does not offer it refuses by name.

Small scenes of two blocks stand for all: a constant stiffness, moduli that are parameters, a shape,
a body that contact alone holds, a body that flows. ``cases`` of the report say for each kind, verb
and place how it ended; the page ``docs/contract.md`` lists what is refused, and why.

    python benchmarks/contract.py [--out DIR] [--quick] [--seed N] [--page docs/contract.md]
"""

from __future__ import annotations

import copy
import csv
import dataclasses
import pickle
import tempfile
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import _demos  # noqa: F401 (before the parts of demos)
import numpy as np
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx.errors import NotOfferedError, OutsideTrainingError, ParameterError
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.models.estimates import FORCES_INDICATOR, STRESS_INDICATOR

EXACT = 1e-9
"""Difference that copies, files and tables may make: other libraries and other orders of summation,
1e-12 seen.
"""
LOOSE = 0.05
"""Difference of a small model from the full order that says that it answers the right question.

3 % was seen.
"""


class Kind(NamedTuple):
    """A kind of model.

    Attributes:
        make: makes one.
        full: makes the full model of its scene.
        mu: a parameter at which contact is partly open.
    """

    make: Callable[[], Any]
    full: Callable[[], hhr.FullOrderModel]
    mu: dict[str, float]


class Case(NamedTuple):
    """How one combination ended: ``answers``, ``refused``, ``unknown`` (nothing is known of the
    error), ``broken``.
    """

    kind: str
    verb: str
    place: str
    outcome: str
    why: str = ""


# ---------------------------------------------------------------- scenes


def blocks(
    lower: Any = (3.0, 0.3),
    *,
    free: bool = False,
    law: Any = None,
    friction: Any = None,
    **others: Any,
) -> hhr.Scene:
    """Two blocks on each other: the lower one is clamped, the upper one pushed down, or pressed
    where it is free.
    """
    side = two_blocks.side
    box = {"press": (0.01, 0.1)} if free else {"push": (0.005, 0.06), "load": (0.0, 0.1)}
    box |= others.pop("box", {})
    top, flank = side(two_blocks.SECOND, 1, True), side(two_blocks.SECOND, 0, True)
    faces = side(two_blocks.FIRST, 1, True), side(two_blocks.SECOND, 1, False)
    held = [hhr.Displacement(side(two_blocks.FIRST, 1, False), axis) for axis in range(2)]
    moved = [hhr.Displacement(top, 0)]
    moved += [] if free else [hhr.Displacement(top, 1, hhr.Amplitude(slopes={"push": -1.0}))]
    load = hhr.Pressure(
        top if free else flank, hhr.Amplitude(slopes={"press" if free else "load": 1.0})
    )
    return hhr.Scene(
        name="contract",
        geometry=lambda comm: two_blocks.two_blocks(
            comm, first=((1.0, 0.0), (2.0, 1.0), (3, 3)), second=((1.0, 1.0), (2.0, 2.0), (3, 3))
        ),
        hypothesis="plane_strain",
        bodies=(hhr.Body(two_blocks.FIRST, *lower, law), hhr.Body(two_blocks.SECOND, 5.0, 0.3)),
        contacts=(hhr.NodeToNode(*faces, (0.0, 1.0), friction),),
        parameters=hhr.ParameterSpace(tuple(box), *zip(*box.values(), strict=True)),
        displacements=(*held, *moved),
        loads=(load,),
        outputs=(hhr.LargestPressure("peak", 0), hhr.ContactForce("force", 0, (0.0, 1.0))),
        **others,
    )


MODULI = {"E1": (1.0, 6.0)}
SHAPE = {"crown": (0.0, 0.02)}
MIDDLE = {"push": 0.03, "load": 0.05}


def crowned() -> Any:
    """Shape of the lower body, whose upper side is crowned."""
    return hhr.Shape(two_blocks.FIRST, ("x", "y - crown * y * (x - 1.5)**2"))


@cache
def training(name: str) -> hhr.Training:
    """Training of a scene; Sobol points keep clear of the border of the box."""
    scene = {
        "constant": lambda: blocks(),
        "moduli": lambda: blocks(("E1", 0.3), box=MODULI),
        "shape": lambda: blocks(box=SHAPE, shapes=(crowned(),)),
        "floating": lambda: blocks(free=True),
        "floating moduli": lambda: blocks(("E1", 0.3), free=True, box=MODULI),
    }[name]()
    return hhr.train(scene, hhr.Sobol(16), held_out=0, comm=MPI.COMM_SELF)


def path(top: float, steps: int = 4) -> list:
    """Pushed down and up again."""
    shares = [k / steps for k in range(steps + 1)] + [1 - k / steps for k in range(1, 3)]
    return [(0.25 * k, [0.005 + share * (top - 0.005), 0.02]) for k, share in enumerate(shares)]


@cache
def flowing() -> hhr.Training:
    """Training of a scene whose lower body yields."""
    scene = blocks(law=hhr.Plasticity(yield_stress=0.03, hardening=0.3))
    return hhr.train(scene, [path(0.03), path(0.05)], held_out=[path(0.04)], comm=MPI.COMM_SELF)


AS_IT_IS = hhr.Recipe().as_it_is()


def reduced_flow(item: hhr.Training) -> Any:
    """The hyper-reduced model of a training of histories."""
    return item.build(hhr.Recipe.flowing(domain=hhr.Rid(1, 3)).as_it_is())


def condensed_flow(item: hhr.Training) -> Any:
    """The condensed model of a training of histories."""
    from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings

    return item.condense(CorrectionSettings(primal=1.0, dual=1.0))


@cache
def rubbing_flow() -> hhr.Training:
    """Training of a scene whose lower body yields, with friction."""
    scene = blocks(law=hhr.Plasticity(yield_stress=0.03, hardening=0.3), friction=0.1)
    return hhr.train(scene, [path(0.03), path(0.05)], held_out=[path(0.04)], comm=MPI.COMM_SELF)


@cache
def rubbing(kind: str) -> hhr.FullOrderModel:
    """Full model of a scene with friction."""
    scene = {
        "constant": lambda: blocks(friction=0.1),
        "moduli": lambda: blocks(("E1", 0.3), friction="0.05 * E1", box=MODULI),
        "floating": lambda: blocks(free=True, friction=0.1),
        "shape": lambda: blocks(friction=0.1, box=SHAPE, shapes=(crowned(),)),
    }[kind]()
    return hhr.FullOrderModel(scene, MPI.COMM_SELF)


def hyper_reduced(full: hhr.FullOrderModel) -> Any:
    """A model of paths that load, shear and turn round, at some points of what stays along each."""
    space, fixed = full.parameters, full.law.fixed
    rest = np.clip(0.0, space.lower, space.upper)
    histories = []
    for point in space.random(12, seed=1):
        start = rest.copy()
        start[fixed] = point[fixed]
        shares = (0.25, 0.5, 1.0, 0.6)
        histories.append(
            full.march(
                [
                    (0.0, start),
                    *((1.0 + k, start + s * (point - start)) for k, s in enumerate(shares)),
                ]
            )
        )
    recipe = hhr.Recipe.with_friction(domain=hhr.Rid(1, 1), enrichment=hhr.Enrich(2.0)).as_it_is()
    return hhr.build(full, hhr.SnapshotSet.of_histories(histories), recipe)


def sliding(condensed: bool) -> Any:
    """A model of surfaces that are paired anew."""
    scene = blocks(friction=0.1)
    lower, upper = scene.contacts[0].tags
    return hhr.slide(
        dataclasses.replace(
            scene,
            geometry=lambda comm: two_blocks.two_blocks(
                comm,
                first=((0.0, 0.0), (3.0, 1.0), (9, 3)),
                second=((1.0, 1.0), (2.0, 2.0), (4, 4)),
            ),
            contacts=(hhr.NodeToSurface(upper, lower, friction=0.1),),
            outputs=scene.outputs[1:],
        ),
        condensed=condensed,
    )


def local_set() -> Any:
    """The same model for either half of the box."""
    from hhr_dolfinx.plugins.local_models.models import LEAF, Choice

    model = training("constant").build(AS_IT_IS)
    other = model.changed(fields=dataclasses.replace(model.fields))
    axis, inner = np.array([0, LEAF, LEAF]), np.array([1, 0, 0])
    choice = Choice(
        axis, np.array([0.03, 0.0, 0.0]), inner, 2 * inner, np.array([0, 0, 1]), np.zeros(2)
    )
    return hhr.LocalModels([model, other], choice)


def _elastic(name: str, make: Callable[[hhr.Training], Any], mu: dict[str, float]) -> Kind:
    return Kind(lambda: make(training(name)), lambda: training(name).full_order, mu)


def _flowing(make: Callable[[hhr.Training], Any]) -> Kind:
    return Kind(lambda: make(flowing()), lambda: flowing().full_order, {"push": 0.04, "load": 0.02})


def _rubbing_flow(make: Callable[[hhr.Training], Any]) -> Kind:
    return Kind(
        lambda: make(rubbing_flow()),
        lambda: rubbing_flow().full_order,
        {"push": 0.04, "load": 0.02},
    )


def _rubbing(name: str, make: Callable[[hhr.FullOrderModel], Any], mu: dict[str, float]) -> Kind:
    return Kind(lambda: make(rubbing(name)), lambda: rubbing(name), mu)


def naive(full: hhr.FullOrderModel) -> Any:
    """The naive full order."""
    from hhr_dolfinx.plugins.baselines.naive import NaiveFullOrder

    return NaiveFullOrder(full)


OF_PLUGINS = {
    "sliding past the mesh": ("sliding", "friction"),
    "naive": ("baselines",),
    "local models": ("local_models",),
    "fallback": ("fallback", "exact_errors"),
    "in a fallback": ("fallback", "exact_errors"),
    "in a table": ("tables",),
    "by hhr answer": ("tables",),
}
"""Kinds and places that plug-ins add, which may have been deleted."""
BY_WORD = {
    "friction": "friction",
    "HHR, friction": "exact_errors",
    "flowing": "inelastic",
    "moduli": "moduli",
    "interpolated": "moduli",
    "shape": "shapes",
    "floating": "floating",
}
"""Plug-ins of all kinds that have a word in their names."""


def needed(name: str) -> set[str]:
    """Plug-ins that a kind or a place needs."""
    return {
        *OF_PLUGINS.get(name, ()),
        *(plugin for word, plugin in BY_WORD.items() if word in name),
    }


def there(cases: dict[str, Any]) -> dict[str, Any]:
    """Those whose plug-ins are installed."""
    return {
        name: case for name, case in cases.items() if needed(name) <= registry.installed().keys()
    }


VARIED, PRESSED = {**MIDDLE, "E1": 2.5}, {"press": 0.05}
KINDS = there(
    {
        "full": _elastic("constant", lambda item: item.full_order, MIDDLE),
        "naive": _elastic("constant", lambda item: naive(item.full_order), MIDDLE),
        "exact condensation": _elastic(
            "constant",
            lambda item: hhr.exact_condensation(item.full_order, item.snapshots.known_statuses()),
            MIDDLE,
        ),
        "exact condensation, floating": _elastic(
            "floating",
            lambda item: hhr.exact_condensation(item.full_order, item.snapshots.known_statuses()),
            PRESSED,
        ),
        "interpolated condensation, moduli": _elastic(
            "moduli", lambda item: item.condense(), VARIED
        ),
        "interpolated condensation, shape": _elastic(
            "shape", lambda item: item.condense(), {**MIDDLE, "crown": 0.01}
        ),
        "interpolated condensation, floating": _elastic(
            "floating moduli", lambda item: item.condense(), {**PRESSED, "E1": 2.5}
        ),
        "HHR, constant": _elastic("constant", lambda item: item.build(AS_IT_IS), MIDDLE),
        "HHR, moduli": _elastic("moduli", lambda item: item.build(AS_IT_IS), VARIED),
        "HHR, shape": _elastic(
            "shape", lambda item: item.build(AS_IT_IS), {**MIDDLE, "crown": 0.01}
        ),
        "HHR, floating": _elastic("floating", lambda item: item.build(AS_IT_IS), PRESSED),
        "local models": _elastic("constant", lambda item: local_set(), MIDDLE),
        "fallback": _elastic("constant", lambda item: _in_fallback("HHR, constant"), MIDDLE),
        "full, flowing": _flowing(lambda item: item.full_order),
        "HHR, flowing": _flowing(reduced_flow),
        "condensed, flowing": _flowing(condensed_flow),
        "full, friction": _rubbing("constant", lambda full: full, MIDDLE),
        "exact condensation, friction": _rubbing("constant", hhr.condense, MIDDLE),
        "exact condensation, friction and floating": _rubbing("floating", hhr.condense, PRESSED),
        "interpolated condensation, friction": _rubbing(
            "moduli", lambda full: hhr.condense(full, fields=True), VARIED
        ),
        "interpolated condensation, friction and shape": _rubbing(
            "shape", lambda full: hhr.condense(full, fields=True), {**MIDDLE, "crown": 0.01}
        ),
        "HHR, friction": _rubbing("constant", hyper_reduced, MIDDLE),
        "HHR, friction and moduli": _rubbing("moduli", hyper_reduced, VARIED),
        "HHR, friction and shape": _rubbing("shape", hyper_reduced, {**MIDDLE, "crown": 0.01}),
        "HHR, friction and floating": _rubbing("floating", hyper_reduced, PRESSED),
        "sliding past the mesh": Kind(
            lambda: sliding(True), lambda: sliding(False), {"push": 0.03, "load": 0.005}
        ),
        "full, friction and flowing": _rubbing_flow(lambda item: item.full_order),
        "HHR, friction and flowing": _rubbing_flow(reduced_flow),
    }
)


@cache
def model_of(kind: str) -> Any:
    """A model of a kind, made once."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return KINDS[kind].make()


@cache
def exact(kind: str) -> Any:
    """The answer of the full order at the parameter of a kind."""
    return KINDS[kind].full().solve(KINDS[kind].mu)


# ---------------------------------------------------------------- verbs


class Context(NamedTuple):
    """What a verb is tried on: a model as it stands in its place, its kind, and whether it has a
    mesh.
    """

    model: Any
    kind: str

    @property
    def mu(self) -> dict[str, float]:
        """The parameter."""
        return KINDS[self.kind].mu

    def solved(self, **how: Any) -> Any:
        """Its answer."""
        return self.model.solve(self.mu, outside="ignore", **how)

    def near(self, found: np.ndarray, name: str) -> None:
        """Hold a field against the full order, and the same of the model in memory."""
        reference = getattr(exact(self.kind), name)()
        own = getattr(model_of(self.kind).solve(self.mu, outside="ignore"), name)()
        assert _difference(found, reference) < LOOSE, (
            f"{name} is off by {_difference(found, reference):.1g}"
        )
        assert _difference(found, own) < EXACT, (
            f"{name} differs by {_difference(found, own):.1g} from that in memory"
        )


def _difference(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.abs(np.subtract(found, expected)).max() / np.abs(expected).max())


def _solve(item: Context) -> None:
    assert item.solved().converged


def _solve_many(item: Context) -> None:
    points = np.array([list(item.mu.values())] * 3)
    points[1:, 0] *= [0.9, 1.1]
    many = item.model.solve_many(points, outside="ignore")
    assert len(many) == 3 and many.converged.all() and len(list(many)) == 3
    item.near(many.forces()[0], "forces")
    item.near(many[0].displacement(), "displacement")
    assert many.outputs()["force"].shape == (3,)
    many.estimates()


def _march(item: Context) -> None:
    space = item.model.parameters
    start = np.array([item.mu[name] for name in space.names])
    start[0] = space.lower[0] if space.names[0] != "press" else start[0] / 2
    end = np.array(list(item.mu.values()))
    points = [(0.5 * k, start + 0.5 * k * (end - start)) for k in range(3)]
    history = item.model.march(points, hhr.MarchSettings(outside="ignore"))
    assert [answer.time for answer in history.answers] == [0.5, 1.0] and history.answers[
        -1
    ].converged


def _outputs(item: Context) -> None:
    values = item.model.outputs(item.mu, outside="ignore")
    reference = exact(item.kind).outputs()
    assert values.keys() == reference.keys() and "force" in values
    for name in reference.keys():
        assert abs(values[name] - reference[name]) < LOOSE * abs(reference[name]), name


def _gradient(item: Context) -> None:
    if item.model.equilibrium is None:
        assert item.solved(gradient=True).gradient.multipliers.shape[1] == len(item.mu)
        return
    settings = hhr.MarchSettings(
        outside="ignore", gradient=True, relative_force=1e-8, relative_stress=1e-8
    )
    history = item.model.march(path(0.03), settings)
    assert history.answers[-1].gradient.multipliers.shape[1] == len(item.mu)


class Unknown(Exception):
    """Nothing is known of an error."""


def _estimate(item: Context) -> None:
    estimate = item.solved().estimate()
    if estimate is None:
        raise Unknown
    assert (
        estimate.kind in ("bound", "estimate", "indicator", STRESS_INDICATOR, FORCES_INDICATOR)
        and estimate.dual_relative >= 0
    )


def _field(name: str) -> Callable[[Context], None]:
    def check(item: Context) -> None:
        item.near(getattr(item.solved(), name)(), name)

    return check


def _refuses(kind: type[Exception], **how: Any) -> Callable[[Context], None]:
    """Wrong words end in an error of their own, whatever the kind."""

    def check(item: Context) -> None:
        given = {"outside": "ignore", **how}
        point = given.pop("mu", item.mu)
        try:
            item.model.solve(point, **given)
        except kind as error:
            if isinstance(error, NotOfferedError):
                raise
            return
        raise AssertionError(f"{how} is accepted")

    return check


def _bad_point(item: Context) -> None:
    for value in (np.nan, 1e9):
        _refuses(ParameterError, mu={**item.mu, next(iter(item.mu)): value})(item)
    many = np.full((1, len(item.mu)), np.nan)
    try:
        item.model.solve_many(many)
    except ParameterError:
        return
    raise AssertionError("a table with NaN is accepted")


def _no_exception(item: Context) -> None:
    assert item.solved(raise_on_failure=False).converged


def _outside(item: Context) -> None:
    _refuses(ParameterError, outside="rubbish")(item)
    corner = {
        name: low
        for name, low in zip(item.model.parameters.names, item.model.parameters.lower, strict=True)
    }
    try:
        item.model.solve(corner, outside="refuse", raise_on_failure=False)
    except OutsideTrainingError:
        return


VERBS: dict[str, Callable[[Context], None]] = {
    "solve": _solve,
    "solve_many": _solve_many,
    "march": _march,
    "outputs": _outputs,
    "gradient": _gradient,
    "estimate": _estimate,
    "displacement": _field("displacement"),
    "forces": _field("forces"),
    "stress": _field("stress"),
    "bad start": _refuses(ParameterError, start="rubbish"),
    "bad point": _bad_point,
    "raise_on_failure": _no_exception,
    "outside": _outside,
}

# ---------------------------------------------------------------- places


def _from_file(kind: str) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        hhr.save_model(Path(folder) / "model.npz", model_of(kind))
        return hhr.load_model(Path(folder) / "model.npz")


def _in_fallback(kind: str) -> Any:
    model = model_of(kind)
    of = (
        "forces" if model.fields.interface is not None else None
    )  # their indicator is silent on all else
    return hhr.FallbackModel(model, KINDS[kind].full(), 0.05, of=of)


PLACES: dict[str, Callable[[str], Any]] = there(
    {
        "in memory": model_of,
        "copied": lambda kind: copy.copy(model_of(kind)),
        "pickled": lambda kind: pickle.loads(pickle.dumps(model_of(kind))),
        "from a file": _from_file,
        "in a fallback": _in_fallback,
    }
)


def _table(kind: str) -> None:
    """A table, of which one row is bad, in memory."""
    model, mu = model_of(kind), np.array(list(KINDS[kind].mu.values()))
    found = hhr.answer_points(
        model, np.array([mu, np.full(mu.size, np.nan)]), outside="ignore", displacement=True
    )
    assert found.status[0] == "ok" and found.status[1] != "ok" and np.isnan(found.forces[1]).all()
    Context(model, kind).near(found.forces[0], "forces")
    assert {head.split(" ")[0] for head in found.outputs} == set(exact(kind).outputs().keys())


def _command(kind: str) -> None:
    """``hhr answer`` and ``hhr solve`` with a file."""
    from click.testing import CliRunner

    from hhr_dolfinx.command.main import hhr as command

    mu = KINDS[kind].mu
    with tempfile.TemporaryDirectory() as given:
        folder = Path(given)
        hhr.save_model(folder / "model.npz", model_of(kind))
        values = ",".join(repr(value) for value in mu.values())
        (folder / "q.csv").write_text(f"{','.join(mu)}\n{values}\n{values}\n")
        words = [
            "answer",
            str(folder / "model.npz"),
            str(folder / "q.csv"),
            "--out",
            str(folder / "a.csv"),
        ]
        run = CliRunner().invoke(command, words, catch_exceptions=False)
        rows = list(csv.DictReader((folder / "a.csv").open()))
        assert run.exit_code in (0, 1) and len(rows) == 2, run.output
        statuses = {row["status"] for row in rows}
        assert statuses == {"ok"} or all(
            "outside what was trained" in status for status in statuses
        ), statuses
        at = ",".join(f"{name}={value!r}" for name, value in mu.items())
        run = CliRunner().invoke(
            command, ["solve", str(folder / "model.npz"), "--at", at], catch_exceptions=False
        )
        assert run.exit_code == 0 and "force" in run.output, run.output


TABLES: dict[str, Callable[[str], None]] = there({"in a table": _table, "by hhr answer": _command})


# ---------------------------------------------------------------- outcomes


def _ended(action: Callable[..., Any], *given: Any) -> tuple[str, str]:
    """How an action ended, and why."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            action(*given)
    except NotOfferedError as error:
        return "refused", str(error)
    except Unknown:
        return "unknown", ""
    except Exception as error:
        return "broken", f"{type(error).__name__}: {error}"
    return "answers", ""


def cases_of(kind: str) -> list[Case]:
    """All cases of a kind.

    One that cannot be made, or be brought to a place, has one case for that.
    """
    found = [Case(kind, "make", "in memory", *_ended(model_of, kind))]
    if found[0].outcome != "answers":
        return found
    for place, brought in PLACES.items():
        outcome = _ended(brought, kind)
        if outcome[0] != "answers":
            found.append(Case(kind, "make", place, *outcome))
            continue
        item = Context(brought(kind), kind)
        found += [Case(kind, verb, place, *_ended(check, item)) for verb, check in VERBS.items()]
    return found + [
        Case(kind, "answer", place, *_ended(check, kind)) for place, check in TABLES.items()
    ]


def page(cases: list[Case]) -> str:
    """The page of what is refused, and of what nothing is known."""
    lines = [
        "# What each kind of model offers",
        "",
        f"Made by `benchmarks/contract.py`: {len(KINDS)} kinds of models, {len(VERBS)} verbs, "
        f"{len(PLACES) + len(TABLES)} places. All answer but for those below: "
        "`refused` by a `NotOfferedError` with this reason; `unknown`, since nothing is known of "
        "the error and `estimate()` is None.",
        "",
        "| kind | verb | place | outcome | why |",
        "|---|---|---|---|---|",
    ]
    groups: dict[tuple[str, str, str, str], list[str]] = {}
    for case in cases:
        if case.outcome != "answers":
            groups.setdefault((case.kind, case.verb, case.outcome, case.why), []).append(case.place)
    for (kind, verb, outcome, why), places in groups.items():
        lines.append(
            f"| {kind} | {verb} | {', '.join(places)} | {outcome} | {' '.join(why.split())} |"
        )
    return "\n".join(lines) + "\n"


QUICK = tuple(
    there(
        dict.fromkeys(
            (
                "full",
                "naive",
                "exact condensation",
                "exact condensation, floating",
                "interpolated condensation, moduli",
                "HHR, constant",
                "HHR, moduli",
                "HHR, floating",
                "fallback",
                "full, flowing",
                "condensed, flowing",
                "full, friction",
                "exact condensation, friction and floating",
            )
        )
    )
)
"""Kinds whose cases take two seconds together; all of them take two minutes."""


def main() -> None:
    """Try all cases; write the report, and the page if it is asked for."""
    from parts import cli

    from hhr_dolfinx.plugins.studies import report

    parser = cli.demo_parser("contract", __doc__)
    parser.add_argument("--page", type=Path, help="the page to write, of all kinds")
    options = cli.parse_on_first_rank(parser)
    if options.page is not None and options.quick:
        parser.error(
            "--page lists all kinds, and --quick tries some of them: leave one of both out"
        )
    cases = [case for kind in (QUICK if options.quick else KINDS) for case in cases_of(kind)]
    written = {
        "scene": "contract",
        "seed": options.seed,
        "cases": [case._asdict() for case in cases],
    }
    report.write_report({**written, **report.environment()}, options.out)
    if options.page is not None:
        options.page.write_text(page(cases))
    for outcome in ("answers", "refused", "unknown", "broken"):
        print(f"{outcome}: {sum(case.outcome == outcome for case in cases)}")
    for case in cases:
        if case.outcome == "broken":
            print(" | ".join(case))


if __name__ == "__main__":
    main()
