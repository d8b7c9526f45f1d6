"""Kinds of models that ``scripts/same.py`` dumps, each on a small scene, and the numbers that each
of them gives.

This file runs with the package of two commits. It names nothing but public names, and finds the few
others by :func:`in_tree`, wherever a commit keeps them. What a commit does not have is recorded
with its error. After a change of the API give a reader below one way more; the old way stays for as
long as the base has it.

Left out: ``hhr.reduce`` and reports of studies, whose choices depend on measured times; pictures.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import re
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import Enum
from functools import cache, partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import issparse

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import hertz_half_discs, two_blocks

LOWER, UPPER, SIDE = two_blocks.FIRST, two_blocks.SECOND, two_blocks.side
MOVING = ("push", "load", "press", "aside")
"""Parameters that change along a path; all others are constants of the bodies."""
SHARES = (0.0, 0.4, 1.0, 0.7, 0.2, 0.8)
"""Of the way from rest to the parameter of a kind, at the times of a path: loaded, unloaded and
loaded again.
"""
MADE = re.compile(rb'"made":"[^"]*"')
"""Date and version on a page."""
QUIET = hhr.MarchSettings(outside="ignore")
TIGHT = {"outside": "ignore", "relative_force": 1e-8, "relative_stress": 1e-8}


def in_tree(name: str) -> Any:
    """A class or function of the package by its name, in whatever file a commit keeps it.

    Raises:
        LookupError: where no file has it.
    """
    folders = (
        (Path(module.__path__[0]), module.__name__) for module in (hhr, geometries_package())
    )
    for folder, package in folders:
        for path in sorted(folder.rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            if f"class {name}" not in text and f"def {name}" not in text:
                continue
            if any(getattr(node, "name", None) == name for node in ast.parse(text).body):
                parts = path.relative_to(folder).with_suffix("").parts
                module = ".".join((package, *(part for part in parts if part != "__init__")))
                return getattr(importlib.import_module(module), name)
    raise LookupError(f"no file has {name}")


def geometries_package() -> Any:
    """The package of geometries, which need not lie in the folder of the other modules."""
    return importlib.import_module("hhr_dolfinx.geometries")


# ---------------------------------------------------------------- scenes


OF_FRICTION = (
    hhr.FrictionForce("shear", 0, (1.0, 0.0)),
    hhr.LargestSlip("slip", 0),
    hhr.DissipatedWork("work", 0),
    hhr.LargestWear("wear", 0, 1e-3),
    hhr.StickArea("sticks", 0),
)
MODULI, BOTH = {"E1": (1.0, 6.0)}, {"E1": (1.0, 6.0), "nu1": (0.2, 0.4)}
SHAPE = {"crown": (0.0, 0.02)}
MIDDLE = {"push": 0.03, "load": 0.05}
VARIED, PRESSED = {**MIDDLE, "E1": 2.5}, {"press": 0.05}
YIELDS = hhr.Plasticity(yield_stress=0.03, hardening=0.3)


def blocks(
    lower: Any = (3.0, 0.3),
    *,
    free: bool = False,
    law: Any = None,
    friction: Any = None,
    hypothesis: str = "",
    pairing: Any = None,
    cells: int = 3,
    other_cells: int = 3,
    simplices: bool = False,
    **others: Any,
) -> hhr.Scene:
    """Two blocks on each other, the lower one clamped.

    The upper one is pushed down and its flank is loaded; a free one is pressed, and contact alone
    holds it.
    """
    dim = 3 if hypothesis == "solid" else 2
    up = dim - 1
    box = {"press": (0.01, 0.1)} if free else {"push": (0.005, 0.06), "load": (0.0, 0.1)}
    box |= others.pop("box", {})
    top, flank = SIDE(UPPER, up, True), SIDE(UPPER, 0, True)
    surfaces = SIDE(LOWER, up, True), SIDE(UPPER, up, False)
    normal = (0.0,) * up + (1.0,)
    held = [hhr.Displacement(SIDE(LOWER, up, False), axis) for axis in range(dim)]
    held += [hhr.Displacement(top, axis) for axis in range(up)]
    held += [] if free else [hhr.Displacement(top, up, hhr.Amplitude(slopes={"push": -1.0}))]
    load = hhr.Pressure(
        top if free else flank, hhr.Amplitude(slopes={"press" if free else "load": 1.0})
    )
    corners = [
        (1.0,) * up + (0.0,),
        (2.0,) * up + (1.0,),
        (1.0,) * up + (1.0,),
        (2.0,) * up + (2.0,),
    ]
    made = (
        hhr.NodeToNode(*surfaces, normal, friction)
        if pairing is None
        else pairing(*surfaces, friction=friction)
    )
    given = {
        "loads": (load,),
        "outputs": (hhr.LargestPressure("peak", 0), hhr.ContactForce("force", 0, normal)),
    }
    return hhr.Scene(
        name="same",
        geometry=lambda comm: two_blocks.two_blocks(
            comm,
            first=(*corners[:2], (cells,) * dim),
            second=(*corners[2:], (other_cells,) * dim),
            simplices=simplices,
        ),
        hypothesis=hypothesis or "plane_strain",
        bodies=(hhr.Body(LOWER, *lower, law), hhr.Body(UPPER, 5.0, 0.3)),
        contacts=(made,),
        parameters=hhr.ParameterSpace(tuple(box), *zip(*box.values(), strict=True)),
        displacements=tuple(held),
        **given | others,
    )


def with_outputs(scene: hhr.Scene, outputs: Sequence[Any]) -> hhr.Scene:
    """A scene with more outputs."""
    return dataclasses.replace(scene, outputs=(*scene.outputs, *outputs))


def of_fields() -> tuple[Any, ...]:
    """Outputs that read displacements and areas."""
    return (
        hhr.DisplacementAt("moved", (2.0, 2.0), 1),
        hhr.VonMises("mises", LOWER),
        hhr.ElasticEnergy("energy"),
        hhr.ContactWidth("width", 0),
        hhr.LostContact("lost", 0),
    )


def crowned() -> Any:
    """Shape of the lower body, whose upper side is crowned."""
    return hhr.Shape(LOWER, ("x", "y - crown * y * (x - 1.5)**2"))


def volume_loads() -> tuple[Any, ...]:
    """Loads of all kinds, of which one is no sum of products of formulas and columns."""
    return (
        hhr.BodyForce(UPPER, (0.3, 1.0), "-0.02 * load"),
        hhr.ThermalExpansion(LOWER, "1e-3 * (1 + E1)", "load"),
        hhr.Eigenstrain(UPPER, "0.01 * load"),
        hhr.Traction(SIDE(UPPER, 0, False), (1.0, 0.0), "0.1 * load**2"),
        hhr.PartialPressure(
            SIDE(UPPER, 0, True), hhr.Amplitude(slopes={"load": 1.0}), extent="reach"
        ),
    )


def half_discs() -> hhr.Scene:
    """Hertz' contact of the thesis on a coarse mesh."""
    towards = {hertz_half_discs.LOWER_FLAT: 0.5, hertz_half_discs.UPPER_FLAT: -0.5}
    tags = hertz_half_discs.LOWER_ARC, hertz_half_discs.UPPER_ARC
    return hhr.Scene(
        name="same_discs",
        geometry=lambda comm: hertz_half_discs.half_discs(comm, arc_segments=24, flat_segments=6),
        hypothesis="plane_strain",
        bodies=tuple(
            hhr.Body(tag, 15.0, 0.35) for tag in (hertz_half_discs.LOWER, hertz_half_discs.UPPER)
        ),
        contacts=(hhr.NodeToNode(*tags, normal=(0.0, 1.0)),),
        parameters=hhr.ParameterSpace(("push",), (0.15,), (0.45,)),
        displacements=tuple(
            hhr.Displacement(tag, axis, amplitude)
            for tag, slope in towards.items()
            for axis, amplitude in (
                (0, hhr.Amplitude()),
                (1, hhr.Amplitude(slopes={"push": slope})),
            )
        ),
        outputs=(hhr.LargestPressure("peak", 0),),
    )


def elastic_scene(name: str) -> hhr.Scene:
    """An elastic scene without friction."""
    plain = {
        "constant": partial(blocks),
        "moduli": partial(blocks, ("E1", 0.3), box=MODULI),
        "E and nu": partial(blocks, ("E1", "nu1"), box=BOTH),
        "shape": lambda: blocks(box=SHAPE, shapes=(crowned(),)),
        "floating": partial(blocks, free=True),
        "loads": partial(blocks, box={"E1": (1.0, 6.0), "reach": (1.2, 1.9)}, loads=volume_loads()),
        "axisymmetric": partial(blocks, hypothesis="axisymmetric"),
        "plane stress": partial(blocks, hypothesis="plane_stress"),
        "second order": partial(blocks, order=2),
        "non-matching": lambda: blocks(pairing=hhr.NodeToSurface, other_cells=4),
        "double pass": lambda: blocks(pairing=hhr.DoublePass, other_cells=4),
        "mortar": lambda: blocks(pairing=hhr.Mortar, other_cells=4),
        "solid": partial(blocks, hypothesis="solid", cells=2, other_cells=2),
        "tetrahedra, moduli": lambda: blocks(
            ("E1", 0.3),
            hypothesis="solid",
            cells=2,
            other_cells=3,
            simplices=True,
            box=MODULI,
            pairing=hhr.Mortar,
        ),
    }
    if name == "half-discs":
        return half_discs()
    scene = plain[name]()
    return with_outputs(scene, of_fields()) if name in ("constant", "moduli", "shape") else scene


@cache
def elastic(name: str) -> Any:
    """Training of an elastic scene."""
    return hhr.train(elastic_scene(name), hhr.Sobol(16), held_out=6, comm=MPI.COMM_SELF)


@cache
def frictional(name: str) -> hhr.FullOrderModel:
    """Full model of an elastic scene with friction."""
    scene = {
        "constant": lambda: with_outputs(blocks(friction=0.1), OF_FRICTION),
        "Tresca": lambda: blocks(friction=hhr.Tresca(0.004)),
        "moduli": lambda: blocks(("E1", 0.3), friction="0.05 * E1", box=MODULI),
        "floating": lambda: blocks(free=True, friction=0.1),
        "shape": lambda: blocks(friction=0.1, box=SHAPE, shapes=(crowned(),)),
        "solid": lambda: blocks(friction=0.2, hypothesis="solid", cells=2, other_cells=2),
        "non-matching": lambda: blocks(friction=0.1, pairing=hhr.NodeToSurface, other_cells=4),
    }[name]()
    return hhr.FullOrderModel(scene, MPI.COMM_SELF)


def yielding_path(top: float, steps: int = 4) -> list[tuple[float, np.ndarray]]:
    """Pushed down and halfway up again."""
    shares = [k / steps for k in range(steps + 1)] + [1 - k / steps for k in range(1, 3)]
    return [
        (0.25 * k, np.array([0.005 + share * (top - 0.005), 0.02]))
        for k, share in enumerate(shares)
    ]


@cache
def inelastic(name: str) -> Any:
    """Training of a scene whose lower body yields or creeps."""
    scene = {
        "plastic": lambda: blocks(law=YIELDS),
        "creep": lambda: blocks(
            law=hhr.Norton(resistance=0.3, exponent=3.0), hypothesis="axisymmetric"
        ),
        "with friction": lambda: blocks(law=YIELDS, friction=0.1),
    }[name]()
    paths, held_out = [yielding_path(0.03), yielding_path(0.05)], [yielding_path(0.04)]
    return hhr.train(scene, paths, held_out=held_out, comm=MPI.COMM_SELF)


@cache
def inelastic_moduli() -> hhr.FullOrderModel:
    """Full model of a body that yields, whose modulus and yield stress are formulas."""
    law = hhr.Plasticity(yield_stress="0.01 * E1", hardening=0.3)
    return hhr.FullOrderModel(blocks(("E1", 0.3), law=law, box=MODULI), MPI.COMM_SELF)


# ---------------------------------------------------------------- models


AS_IT_IS = hhr.Recipe().as_it_is()
INELASTIC = hhr.Recipe.flowing(domain=hhr.Rid(1, 3)).as_it_is()


def hyper_reduced_friction(full: hhr.FullOrderModel) -> Any:
    """A model of paths that load, shear and turn round, at some points of the constants of
    bodies.
    """
    space = full.parameters
    constants = np.array([name not in MOVING for name in space.names])
    rest = np.array(space.lower, dtype=float)
    histories = []
    for point in np.random.default_rng(1).uniform(space.lower, space.upper, (12, rest.size)):
        start = np.where(constants, point, rest)
        shares = (0.0, 0.25, 0.5, 1.0, 0.6)
        histories.append(
            full.march(
                [(float(k), start + share * (point - start)) for k, share in enumerate(shares)]
            )
        )
    recipe = hhr.Recipe.with_friction(domain=hhr.Rid(1, 1), enrichment=hhr.Enrich(2.0)).as_it_is()
    return hhr.build(full, hhr.SnapshotSet.of_histories(histories), recipe)


def sliding(condensed: bool) -> Any:
    """A model of surfaces that are paired anew."""
    scene = blocks(friction=0.1)
    lower, upper = scene.contacts[0].tags
    wide = dataclasses.replace(
        scene,
        geometry=lambda comm: two_blocks.two_blocks(
            comm, first=((0.0, 0.0), (3.0, 1.0), (6, 2)), second=((1.0, 1.0), (2.0, 2.0), (3, 3))
        ),
        contacts=(hhr.NodeToSurface(upper, lower, friction=0.1),),
        outputs=scene.outputs[1:],
    )
    return hhr.slide(wide, condensed=condensed)


def matrices() -> Any:
    """A condensed model of the matrices of another program: a chain of springs above a floor."""
    size = 8
    stiffness = 2 * np.eye(size) - np.eye(size, k=1) - np.eye(size, k=-1)
    contact = np.eye(size)[2:6]
    space = hhr.ParameterSpace(("load", "gap"), (0.0, 0.0), (1.0, 0.5))
    loads = np.stack([np.linspace(0, 1, size), np.zeros(size)], axis=1)
    gaps = np.stack([np.zeros(4), np.linspace(1, 2, 4)], axis=1)
    return hhr.condense_matrices(
        space, stiffness, contact, loads, gaps, ["load", "gap"], areas=np.ones(4)
    )


def greedy(training_of: str) -> Any:
    """A reduced model of points that a greedy training chose."""
    how = hhr.Greedy(
        tolerance=1e-9,
        budget=14,
        start=hhr.Sobol(4),
        candidates=hhr.Lattice(60, levels=8),
        together=4,
    )
    training = hhr.train(elastic_scene(training_of), how, held_out=0, comm=MPI.COMM_SELF)
    return training.build(checked=False)


def local(how: Any) -> Any:
    """Several models of the half-discs, each for a part of the box."""
    return elastic("half-discs").local(how, recipe=AS_IT_IS)


@dataclasses.dataclass(frozen=True)
class Unknowns:
    """An indicator of a user's own: the size of the displacement over its largest unknown."""

    def prepared(self, problem: Any, basis: np.ndarray, sets: Any) -> Callable[[Any], float]:
        """Make the indicator, see ``hhr.Recipe``."""
        return lambda answer: float(
            np.linalg.norm(basis @ answer.unknown) / np.abs(answer.unknown).max()
        )


class Kind(NamedTuple):
    """A kind of model.

    Attributes:
        make: makes one.
        mu: a parameter at which contact is partly open.
        full: makes the full model of its scene, which its page draws; None for no page.
        path: along which it marches; None for :data:`SHARES`.
    """

    make: Callable[[], Any]
    mu: dict[str, float]
    full: Callable[[], Any] | None = None
    path: Callable[[], Any] | None = None


def _kinds() -> Iterator[tuple[str, Kind]]:
    discs = {"push": 0.35}
    points = {
        "constant": MIDDLE,
        "moduli": VARIED,
        "E and nu": {**VARIED, "nu1": 0.33},
        "shape": {**MIDDLE, "crown": 0.01},
        "floating": PRESSED,
        "half-discs": discs,
        "loads": {**VARIED, "reach": 1.6},
        "tetrahedra, moduli": VARIED,
    }
    for name in (
        *("constant", "moduli", "E and nu", "shape", "floating", "loads", "axisymmetric"),
        *("plane stress", "second order", "non-matching", "double pass", "mortar", "solid"),
        *("tetrahedra, moduli", "half-discs"),
    ):
        mu, training = points.get(name, MIDDLE), partial(elastic, name)
        full = partial(lambda training: training().full_order, training)
        yield f"full, {name}", Kind(full, mu)
        yield (
            f"condensed, {name}",
            Kind(partial(lambda training: training().condense(), training), mu, full),
        )
        if name != "shape":
            yield (
                f"HHR, {name}",
                Kind(partial(lambda training: training().build(AS_IT_IS), training), mu),
            )
    constant = partial(elastic, "constant")
    yield "naive", Kind(lambda: in_tree("NaiveFullOrder")(constant().full_order), MIDDLE)
    yield "hhr.condense, constant", Kind(lambda: hhr.condense(elastic_scene("constant")), MIDDLE)
    yield (
        "hhr.condense, moduli, no fields",
        Kind(
            lambda: hhr.condense(elastic("E and nu").full_order, fields=False), points["E and nu"]
        ),
    )
    yield "HHR, checked", Kind(lambda: constant().build(), MIDDLE)
    yield "HHR, moduli, checked", Kind(lambda: elastic("moduli").build(), VARIED)
    yield (
        "HHR, no bound",
        Kind(lambda: constant().build(dataclasses.replace(AS_IT_IS, bound=False)), MIDDLE),
    )
    yield (
        "HHR, cone",
        Kind(lambda: elastic("half-discs").build(hhr.Recipe.thesis(1e-8).as_it_is()), discs),
    )
    indicated = {"bound": False, "indicator": Unknowns()}
    yield (
        "HHR, own indicator",
        Kind(
            lambda: elastic("half-discs").build(dataclasses.replace(AS_IT_IS, **indicated)), discs
        ),
    )
    yield "greedy", Kind(lambda: greedy("constant"), MIDDLE)
    yield "greedy, moduli", Kind(lambda: greedy("moduli"), VARIED)
    yield "local models, split", Kind(lambda: local(hhr.Splitting(modes=6, checks=20)), discs)
    yield "local models, clusters", Kind(lambda: local(hhr.Clusters(2)), discs)
    yield (
        "fallback",
        Kind(
            lambda: elastic("half-discs").safe_model(
                0.01, recipe=hhr.Recipe.thesis(1e-4).as_it_is()
            ),
            discs,
        ),
    )
    yield (
        "fallback, of pressure",
        Kind(lambda: elastic("moduli").safe_model(0.01, of="pressure", recipe=AS_IT_IS), VARIED),
    )
    yield "matrices", Kind(matrices, {"load": 0.6, "gap": 0.2})
    rub = {
        "constant": MIDDLE,
        "Tresca": MIDDLE,
        "moduli": VARIED,
        "floating": PRESSED,
        "solid": MIDDLE,
        "shape": {**MIDDLE, "crown": 0.01},
        "non-matching": MIDDLE,
    }
    for name, mu in rub.items():
        full = partial(frictional, name)
        yield f"full, friction, {name}", Kind(full, mu)
        fields = True if name in ("moduli", "shape") else None
        yield (
            f"condensed, friction, {name}",
            Kind(partial(lambda f, w: hhr.condense(f(), fields=w), full, fields), mu, full),
        )
    for name in ("constant", "moduli", "floating"):
        yield (
            f"HHR, friction, {name}",
            Kind(partial(lambda n: hyper_reduced_friction(frictional(n)), name), rub[name]),
        )
    slid = {"push": 0.03, "load": 0.005}
    yield "sliding past the mesh", Kind(lambda: sliding(True), slid)
    yield "sliding past the mesh, full", Kind(lambda: sliding(False), slid)
    at, along = {"push": 0.04, "load": 0.02}, partial(yielding_path, 0.04)
    for name in ("plastic", "creep", "with friction"):
        training = partial(inelastic, name)
        yield (
            f"full, inelastic, {name}",
            Kind(partial(lambda t: t().full_order, training), at, None, along),
        )
        yield (
            f"HHR, inelastic, {name}",
            Kind(partial(lambda t: t().build(INELASTIC), training), at, None, along),
        )
        if name != "with friction":
            yield (
                f"condensed, inelastic, {name}",
                Kind(
                    partial(
                        lambda t: t().condense(in_tree("CorrectionSettings")(primal=1.0, dual=1.0)),
                        training,
                    ),
                    at,
                    partial(lambda t: t().full_order, training),
                    along,
                ),
            )
    yield "full, inelastic, moduli", Kind(inelastic_moduli, {**at, "E1": 2.5})


KINDS = dict(_kinds())


# ---------------------------------------------------------------- records


class Record:
    """Arrays by name, and errors by the name of what they ended.

    Attributes:
        arrays: numbers, truths and texts.
        errors: package, type and message.
    """

    def __init__(self) -> None:
        self.arrays: dict[str, np.ndarray] = {}
        self.errors: dict[str, str] = {}

    def put(self, name: str, value: Any) -> None:
        """Record what a value holds, part by part; what is no number, truth or text is left out."""
        if value is None or callable(value):
            return
        if isinstance(value, Enum):
            self.arrays[name] = np.array(value.name)
        elif isinstance(value, bool | int | float | str | np.generic):
            self.arrays[name] = np.array(value)
        elif isinstance(value, np.ndarray):
            if value.dtype != object:
                self.arrays[name] = value.copy()
        elif issparse(value):
            self.put(
                name, {part: getattr(value.tocsr(), part) for part in ("data", "indices", "indptr")}
            )
        else:
            for part, item in _parts(value):
                self.put(f"{name}/{part}", item)

    @contextmanager
    def of(self, name: str, counts: Counts | None = None) -> Iterator[None]:
        """A block that may end in an error, which is recorded with the warnings of the package and
        with counts.
        """
        before = {} if counts is None else counts.now()
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            try:
                yield
            except Exception as error:
                kind = type(error)
                self.errors[name] = f"{kind.__module__.split('.')[0]}.{kind.__name__}: {error}"
        own = {
            item.category.__name__
            for item in heard
            if item.category.__module__.startswith("hhr_dolfinx")
        }
        if own:
            self.arrays[f"{name}/warnings"] = np.array(", ".join(sorted(own)))
        if counts is not None:
            for event, count in counts.now().items():
                self.arrays[f"{name}/counts/{event}"] = np.array(count - before[event])

    def read(self, name: str, readers: Mapping[str, Callable[[Any], Any]], value: Any) -> None:
        """Record what readers find, each by itself."""
        for part, reader in readers.items():
            with self.of(f"{name}/{part}"):
                self.put(f"{name}/{part}", reader(value))


def _parts(value: Any) -> Iterable[tuple[Any, Any]]:
    if isinstance(value, Mapping):
        return value.items()
    if hasattr(value, "_fields"):
        return value._asdict().items()
    if dataclasses.is_dataclass(value):
        return [(item.name, getattr(value, item.name)) for item in dataclasses.fields(value)]
    return enumerate(value) if isinstance(value, list | tuple) else ()


class Counts:
    """Numbers of factorisations and solves so far: of PETSc by its log, of LAPACK by wrapped
    classes.
    """

    EVENTS: ClassVar = {
        "factorisations": ("MatCholFctrNum", "MatLUFactorNum"),
        "solves": ("MatSolve",),
        "block solves": ("MatMatSolve",),
    }
    DENSE = ("LapackLU", "LapackCholesky")

    def __init__(self) -> None:
        PETSc.Log.begin()
        self._dense = {"dense factorisations": 0, "dense solves": 0}
        for name in self.DENSE:
            try:
                kind = in_tree(name)
            except LookupError:
                continue
            for method, event in (("refactor", "dense factorisations"), ("solve", "dense solves")):
                if method in vars(kind):
                    setattr(kind, method, self._counted(vars(kind)[method], event))

    def _counted(self, method: Callable[..., Any], event: str) -> Callable[..., Any]:
        def counted(*given: Any, **named: Any) -> Any:
            self._dense[event] += 1
            return method(*given, **named)

        return counted

    def now(self) -> dict[str, int]:
        """Counts by event."""
        found = {
            event: sum(int(PETSc.Log.Event(name).getPerfInfo()["count"]) for name in names)
            for event, names in self.EVENTS.items()
        }
        return found | self._dense


# ---------------------------------------------------------------- what models say


def _memory(answer: Any) -> Any:
    """Plastic strain, slip and all else that the next step starts from."""
    if hasattr(answer, "memory"):
        return answer.memory
    return {"slip": answer.slip, "gauss": answer.gauss}


def _outputs(answer: Any) -> Any:
    found = answer.outputs()
    own = {} if found.gradient is None else found.gradient
    return {"values": dict(found.items()), "gradient": dict(own), "one sided": found.one_sided}


def _columns(found: Any) -> list[Any]:
    """Columns of a table that some kinds of models have: which model answered, whether the full one
    did.
    """
    if hasattr(found, "columns"):
        own = list(found.columns.values())
    else:
        own = [column for column in (found.fell_back, found.model) if column is not None]
    return [np.asarray(column, dtype=float) for column in own]


ANSWER: dict[str, Callable[[Any], Any]] = {
    "unknown": lambda answer: answer.unknown,
    "multipliers": lambda answer: answer.multipliers,
    "active": lambda answer: answer.active,
    "iterations": lambda answer: answer.iterations,
    "status": lambda answer: answer.status,
    "cycled": lambda answer: answer.cycled,
    "undetermined": lambda answer: answer.undetermined,
    "displacement": lambda answer: answer.displacement(),
    "forces": lambda answer: answer.forces(),
    "pressure": lambda answer: answer.pressure(),
    "stress": lambda answer: answer.stress(),
    "plastic strain": lambda answer: answer.plastic_strain(),
    "outputs": _outputs,
    "estimate": lambda answer: answer.estimate(),
    "gradient": lambda answer: answer.gradient,
    "memory": _memory,
}
STEP = ANSWER | {
    "time error": lambda answer: answer.time_error,
    "ends": lambda answer: np.array(answer.ends),
}
MANY: dict[str, Callable[[Any], Any]] = {
    "unknown": lambda many: [answer.unknown for answer in many],
    "multipliers": lambda many: [answer.multipliers for answer in many],
    "active": lambda many: [answer.active for answer in many],
    "iterations": lambda many: many.iterations,
    "status": lambda many: [status.name for status in many.status],
    "forces": lambda many: many.forces(),
    "outputs": lambda many: many.outputs(),
    "estimates": lambda many: many.estimates(),
}
TABLE: dict[str, Callable[[Any], Any]] = {
    "status": lambda found: found.status,
    "forces": lambda found: found.forces,
    "outputs": lambda found: found.outputs,
    "estimates": lambda found: found.estimates,
    "largest displacement": lambda found: found.largest_displacement,
    "total force": lambda found: found.total_force,
    "columns": _columns,
}
HISTORY: dict[str, Callable[[Any], Any]] = {
    "cuts": lambda history: history.cuts,
    "parts": lambda history: np.array(history.parts),
    "iterations": lambda history: np.array(history.iterations),
    "time error": lambda history: history.time_error,
    "signs": lambda history: history.signs,
}


def points_of(model: Any, mu: Mapping[str, float]) -> np.ndarray:
    """Five points of a box, the given one first."""
    space = model.parameters
    lower, upper = np.array(space.lower, dtype=float), np.array(space.upper, dtype=float)
    drawn = lower + np.random.default_rng(5).uniform(0.15, 0.85, (4, lower.size)) * (upper - lower)
    return np.vstack([[mu[name] for name in space.names], drawn])


def path_of(
    model: Any, kind: Kind, shares: Sequence[float] = SHARES
) -> list[tuple[float, np.ndarray]]:
    """Times and parameters of a path; constants of bodies stay what they are."""
    if kind.path is not None:
        return kind.path()
    end = points_of(model, kind.mu)[0]
    moves = np.array([name in MOVING for name in model.parameters.names])
    start = np.where(moves, np.array(model.parameters.lower, dtype=float), end)
    return [(0.25 * k, start + share * (end - start)) for k, share in enumerate(shares)]


def dump_history(
    record: Record, name: str, march: Callable[[], Any], counts: Counts | None
) -> None:
    """Record a history and each of its steps."""
    with record.of(name, counts):
        history = march()
        record.read(name, HISTORY, history)
        for number, answer in enumerate(history.answers):
            record.read(f"{name}/step {number}", STEP, answer)


def dump_file(record: Record, name: str, model: Any, kind: Kind) -> None:
    """Record a model's file, what is in it, and what the model read from it says."""
    with tempfile.TemporaryDirectory() as folder, record.of(name):
        path = Path(folder) / "model.npz"
        hhr.save_model(path, model)
        record.put(f"{name}/bytes", path.stat().st_size)
        with np.load(path) as file:
            record.put(f"{name}/arrays", {key: file[key] for key in file.files if key != "header"})
        loaded = hhr.load_model(path)
        point = points_of(loaded, kind.mu)[0]
        record.read(
            f"{name}/answer", ANSWER, loaded.solve(point, outside="ignore", raise_on_failure=False)
        )
        dump_history(
            record, f"{name}/march", lambda: loaded.march(path_of(loaded, kind), QUIET), None
        )


def dump_exports(record: Record, name: str, model: Any, kind: Kind) -> None:
    """Record the page and the C header of a model, and their sizes."""
    with tempfile.TemporaryDirectory() as folder:
        for part, suffix, write in (
            (
                "page",
                ".html",
                lambda path: hhr.write_model_page(path, model, hhr.scenery_of(kind.full())),
            ),
            ("C header", ".h", lambda path: in_tree("write_c_header")(path, model)),
        ):
            with record.of(f"{name}/{part}"):
                path = Path(folder) / f"model{suffix}"
                write(path)
                text = MADE.sub(b"", path.read_bytes())
                record.put(f"{name}/{part}/bytes", len(text))
                record.put(f"{name}/{part}/text", np.frombuffer(text, dtype=np.uint8))


def dump_kind(record: Record, name: str, counts: Counts) -> None:
    """Record all that a model of a kind gives."""
    kind = KINDS[name]
    # what SciPy draws by itself in bounds of commits before they were without it
    np.random.seed(0)  # noqa: NPY002
    with record.of(f"{name}/make", counts):
        model = kind.make()
    if f"{name}/make" in record.errors:
        return
    how = {"outside": "ignore", "raise_on_failure": False}
    points = points_of(model, kind.mu)
    inelastic_bodies = kind.path is not None or "inelastic" in name
    for number, point in enumerate(points[:3]):
        answer = f"{name}/solve {number}"
        with record.of(answer, counts):
            record.read(answer, ANSWER, model.solve(point, **how))
    if not inelastic_bodies:
        for number, point in enumerate(points[:3]):
            answer = f"{name}/gradient {number}"
            with record.of(answer, counts):
                record.read(answer, ANSWER, model.solve(point, gradient=True, **how))
    with record.of(f"{name}/many", counts):
        record.read(f"{name}/many", MANY, model.solve_many(points, **how))
    with record.of(f"{name}/table", counts):
        table = np.vstack([points[:2], np.full((1, points.shape[1]), np.nan)])
        found = hhr.answer_points(model, table, outside="ignore", displacement=True)
        record.read(f"{name}/table", TABLE, found)
    dump_history(record, f"{name}/march", lambda: model.march(path_of(model, kind), QUIET), counts)
    if inelastic_bodies:
        settings = hhr.MarchSettings(**TIGHT, gradient=True)
        dump_history(
            record, f"{name}/gradient", lambda: model.march(path_of(model, kind), settings), counts
        )
    if "creep" in name:
        settings = hhr.MarchSettings(**TIGHT, time_tolerance=0.01)
        dump_history(
            record, f"{name}/cut", lambda: model.march(path_of(model, kind)[::2], settings), counts
        )
    dump_file(record, f"{name}/file", model, kind)
    if kind.full is not None:
        dump_exports(record, name, model, kind)


def dump(record: Record, chosen: Callable[[str], bool], announce: Callable[[str], None]) -> None:
    """Record all kinds of models that are chosen by name."""
    counts = Counts()
    for name in KINDS:
        if chosen(name):
            announce(name)
            dump_kind(record, name, counts)
