"""Constitutive update of all Gauss points: radial return in compiled loops, with the laws of the scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

import numpy as np

from hhr_dolfinx.compat import compiled
from hhr_dolfinx.declared import Integers
from hhr_dolfinx.errors import ConvergenceError, SceneError
from hhr_dolfinx.materials.elasticity import lame_parameters
from hhr_dolfinx.plugins.inelastic.compiled_laws import ELASTIC, NORTON, PLASTICITY
from hhr_dolfinx.plugins.inelastic.constants import LawOfParameters, ModuliOfParameters, check_law, formulas_of
from hhr_dolfinx.plugins.inelastic.laws import Flow, Norton, Plasticity

if TYPE_CHECKING:
    from hhr_dolfinx.parameters import ParameterSpace

SLOPE = 0.05
"""Relative error of a slope above which a warning is due: differences of the laws here agree to 1e-6, and a missing
factor gives far larger errors."""


class State(NamedTuple):
    """Internal variables of the material."""

    plastic: np.ndarray  # plastic strain, Kelvin's notation, (gauss_points, components)
    cumulated: np.ndarray  # cumulated plastic strain p, (gauss_points,)


class Update(NamedTuple):
    """Result of a step at all Gauss points."""

    stress: np.ndarray  # stress at the end of the step, (gauss_points, components)
    state: State  # state at the end of the step
    tangents: np.ndarray | None  # consistent tangents, (gauss_points, components, components), or None


@dataclass(frozen=True)
class Group:
    """Gauss points of one body."""

    indices: Annotated[Integers, "points"]  # numbers among the model's Gauss points, (n,)
    young: float | str  # Young's modulus E, or a formula of the parameters
    poisson: float  # Poisson's ratio
    law: Flow | None  # of plasticity or creep; its constants may be formulas of the parameters

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults of the elastic constants and of the law."""
        stiff = isinstance(self.young, str) or self.young > 0
        if not (stiff and -1 < self.poisson < 0.5):
            yield f"young = {self.young!r} and poisson = {self.poisson!r} are no constants"
        if self.law is not None and not callable(getattr(self.law, "flow", None)):
            yield f"the law {self.law!r} has no flow: each must have a flow, or be none"


class LastOf:
    """Keeps the value of the last key; threads may share it."""

    def __init__(self) -> None:
        self._last: tuple[object, Any] = None, None

    def of(self, key: object, make: Callable[[], Any]) -> Any:
        """The value of a key, which is not None."""
        last = self._last
        if last[0] != key:
            self._last = last = key, make()  # in one assignment: several threads may be here
        return last[1]


class Material:
    """Laws of all Gauss points of a model.

    Args:
        groups: one group for each body; every Gauss point is in one group.
        components: number of components of a strain, 4 or 6.
        names: names of the parameters, for formulas.

    Raises:
        SceneError: if a Gauss point is in no group or in two, as the compiled loops would access other memory; for
            formulas of unknown parameters.
    """

    kept: ClassVar[tuple[str, ...]] = ("groups", "components", "names")
    """Attributes that a file stores."""

    def __init__(self, groups: Sequence[Group], components: int, names: Sequence[str] = ()):
        self.groups = tuple(groups)
        self.components = components
        self.names = tuple(names)
        numbered = list(enumerate(self.groups))
        self._laws = {k: LawOfParameters(group.law, names) for k, group in numbered if formulas_of(group.law)}
        texts = {k: group.young for k, group in numbered if isinstance(group.young, str)}
        self._moduli = ModuliOfParameters(texts, self.names) if texts else None
        self._at_points = LastOf()
        self._at_moduli = LastOf()
        self._elastic: np.ndarray | None = None
        self.gauss_points = sum(group.indices.size for group in self.groups)
        indices = np.concatenate([np.zeros(0, dtype=np.int64), *(group.indices for group in self.groups)])
        if not np.array_equal(np.sort(indices), np.arange(self.gauss_points)):
            raise SceneError(
                f"the groups of a material must hold each of its Gauss points 0 .. {self.gauss_points - 1} once"
            )
        if self._moduli is None:
            _ = self.elastic

    def faults_for(self, space: ParameterSpace, dimension: int) -> Iterator[str]:
        """Faults of a material read from a file; SceneError for a formula with invalid values in the box."""
        if self.components != (4 if dimension == 2 else 6) or self.names not in ((), space.names):
            yield f"a strain has {self.components} components in dimension {dimension}, and parameters {self.names}"
        for number, group in enumerate(self.groups):
            check_law(group.law, space, f"law {number}")
            if isinstance(group.young, str):
                from hhr_dolfinx.formulas import Scalar, check_over_box

                scalar = Scalar(group.young, space.names)
                check_over_box(scalar, space, "young", 0.0, math.inf, "Young's modulus must be positive")

    @property
    def elastic(self) -> np.ndarray:
        """Elastic tangents, (gauss_points, components, components); moduli must be numbers, see :meth:`moduli_at`."""
        if self._elastic is None:
            elastic = np.empty((self.gauss_points, self.components, self.components))
            unit = np.zeros(self.components)
            unit[:3] = 1.0
            for group in self.groups:
                lam, mu = lame_parameters(_number(group), group.poisson)
                elastic[group.indices] = lam * np.outer(unit, unit) + 2 * mu * np.eye(self.components)
            # a single assignment, since several threads may evaluate this
            self._elastic = elastic
        return self._elastic

    @property
    def flows(self) -> bool:
        """True if any body is inelastic."""
        return any(group.law is not None for group in self.groups)

    @property
    def rated(self) -> bool:
        """True if any law may depend on rates; a law that does not declares ``rated = False``."""
        return any(group.law is not None and getattr(group.law, "rated", True) for group in self.groups)

    def restricted(self, indices: np.ndarray, *, empty: bool = False) -> Material:
        """Material of some Gauss points, renumbered in their order; groups without any are kept if ``empty``."""
        kept = [np.flatnonzero(np.isin(indices, group.indices)) for group in self.groups]
        groups = [
            replace(group, indices=own) for group, own in zip(self.groups, kept, strict=True) if empty or own.size
        ]
        return Material(groups, self.components, self.names)

    def at(self, point: np.ndarray) -> Material:
        """Material with the constants at a point, (P,), the last of which is kept; itself if none is a formula.

        SceneError for constants that are not valid there.
        """
        elastic = self.moduli_at(point)
        if not self._laws:
            return elastic

        def made() -> Material:
            found = copy(elastic)
            laws = {place: law.at(point) for place, law in self._laws.items()}
            groups = enumerate(elastic.groups)
            found.groups = tuple(replace(group, law=laws.get(k, group.law)) for k, group in groups)
            found._laws = {}
            return found

        return self._at_points.of(point.tobytes(), made)

    def moduli_at(self, point: np.ndarray) -> Material:
        """Material with the elasticity at a point, (P,), the last of which is kept; itself if that is constant.

        SceneError for a modulus that is not valid there.
        """
        if self._moduli is None:
            return self
        values = self._moduli.values(point)

        def made() -> Material:
            found = copy(self)
            found.groups = tuple(
                replace(group, young=values.get(k, group.young)) for k, group in enumerate(self.groups)
            )
            found._moduli = found._elastic = None
            found._at_points = LastOf()
            return found

        return self._at_moduli.of(values, made)

    def constants(self, point: np.ndarray) -> list[dict[str, float]]:
        """Values at a point, (P,), of the constants that are formulas, for each group by name."""
        found = [self._laws[place].constants(point) if place in self._laws else {} for place in range(len(self.groups))]
        for place, value in ({} if self._moduli is None else self._moduli.values(point)).items():
            found[place]["young"] = value
        return found

    def at_rest(self) -> State:
        """State without plastic strain."""
        return State(np.zeros((self.gauss_points, self.components)), np.zeros(self.gauss_points))

    def update(self, strain: np.ndarray, old: State, dt: float, *, tangent: bool) -> Update:
        """Stress and state at the end of a step, by laws whose constants are numbers, see :meth:`at`.

        Args:
            strain: total strain at the end of the step, (gauss_points, components).
            old: state before the step; not modified.
            dt: length of the step in seconds.
            tangent: compute consistent tangents.

        Raises:
            SceneError: if a law does not return numbers.
            ConvergenceError: if a law finds no flow, or one that is not valid.
        """
        stress = np.empty_like(strain)
        state = State(old.plastic.copy(), old.cumulated.copy())
        # the kernel takes an empty array if no tangents are needed
        tangents = np.empty((*strain.shape, self.components) if tangent else (0, 0, 0))
        for group in self.groups:
            lam, mu = lame_parameters(_number(group), group.poisson)
            indices = group.indices
            deviator, equivalent = self._trial(indices, strain, old, mu)
            if group.law is None:
                amount = slope = np.zeros(indices.size)
            else:
                equivalent.setflags(write=False)  # a law that wrote to it would corrupt the return below
                amount, slope = flow_of(group.law, equivalent, old.cumulated[indices], mu, dt)
                check_flow(group.law, amount, slope, equivalent, mu)
            step = (indices, strain, deviator, equivalent, amount, slope)
            _return(*step, lam + 2 * mu / 3, mu, stress, *state, tangents)
        return Update(stress, state, tangents if tangent else None)

    def wrong_slopes(self, strain: np.ndarray, old: State, dt: float, reductions: Any) -> list[str] | None:
        """Reports of laws whose slope is not the derivative of their flow; None if too little plastic strain occurs.

        A wrong slope changes no answer, but steps take more iterations, or fail for no visible reason.
        """

        def probed() -> list[_Slopes]:
            found = []
            for group in self.groups:
                if group.law is not None:
                    _, mu = lame_parameters(_number(group), group.poisson)
                    _, equivalent = self._trial(group.indices, strain, old, mu)
                    found.append(_slopes_of(group.law, equivalent, old.cumulated[group.indices], mu, dt))
            return found

        probes = [probe for probe in reductions.agreed(probed) if reductions.largest(probe.slope.size)]
        reports = [reductions.worst(*probe.report(reductions.largest(probe.size))) for probe in probes]
        return [report for report in reports if report] if reports else None

    def _trial(self, indices: np.ndarray, strain: np.ndarray, old: State, mu: float) -> tuple[np.ndarray, np.ndarray]:
        """Deviator and equivalent stress of the trial stress at some Gauss points, (n, components) and (n,)."""
        deviator = np.empty((indices.size, self.components))
        equivalent = np.empty(indices.size)
        _set_trial(indices, strain, old.plastic, mu, deviator, equivalent)
        return deviator, equivalent


def _number(group: Group) -> float:
    """Young's modulus, which must be a number here."""
    if isinstance(group.young, str):
        raise SceneError(
            f"young = {group.young} is a formula of the parameters: material.moduli_at(point) has its number"
        )
    return group.young


def kernel_of(law: object) -> tuple[int, tuple[float, float]] | None:
    """Number of the kernel of a law, and its constants, which must be numbers; None for a user-defined law."""
    if law is None:
        return ELASTIC, (0.0, 0.0)
    if type(law) is Plasticity:
        return PLASTICITY, (float(law.yield_stress), float(law.hardening))
    if type(law) is Norton:
        return NORTON, (float(law.resistance), float(law.exponent))
    return None


def flow_of(law: Flow, trial: np.ndarray, cumulated: np.ndarray, mu: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Flow and slope of a law as arrays; SceneError for other results, ConvergenceError if there is no flow."""
    if not trial.size:  # a rank without points of a body
        return np.zeros(0), np.zeros(0)
    try:
        answer = law.flow(trial, cumulated, mu, dt)
    except ArithmeticError as error:
        raise ConvergenceError(f"{law} found no flow in a step of {dt:g} s: {error}") from error
    except Exception as error:  # a user-defined law may raise anything
        raise SceneError(f"the law {law} failed with {type(error).__name__}: {error}") from error
    try:
        amount, slope = answer
        if np.iscomplexobj(amount) or np.iscomplexobj(slope):
            raise TypeError("complex numbers")
        return np.asarray(amount, dtype=float), np.asarray(slope, dtype=float)
    except (TypeError, ValueError) as error:
        raise SceneError(
            f"the law {law} answered {_shortened(answer)}: its method flow must return two arrays of numbers, "
            "the flow and its derivative"
        ) from error


def _shortened(answer: object, most: int = 60) -> str:
    """Beginning of a law's answer, for messages."""
    text = " ".join(repr(answer).split())
    return text if len(text) <= most else text[:most] + "..."


def check_flow(law: Flow, amount: np.ndarray, slope: np.ndarray, trial: np.ndarray, mu: float) -> None:
    """Raise ConvergenceError for a flow that is not finite or would reverse the stress."""
    if not amount.shape == slope.shape == trial.shape:
        raise ConvergenceError(f"{law} must answer with a flow and a slope of shape {trial.shape}")
    right = np.isfinite(slope) & (amount >= 0) & (3 * mu * amount <= trial * (1 + 1e-9))
    if np.isfinite(trial).all() and not right.all():
        worst = int(np.argmin(right))
        if not np.isfinite(slope[worst]):
            raise ConvergenceError(
                f"{law} has the slope {slope[worst]:g} under an equivalent stress of {trial[worst]:g}: the "
                "derivative of its flow must be finite, and 0 where nothing flows"
            )
        raise ConvergenceError(
            f"{law} flows by {amount[worst]:g} under an equivalent stress of {trial[worst]:g}: between 0 and "
            f"{trial[worst] / (3 * mu):g} was expected"
        )


class _Slopes(NamedTuple):
    """Slopes of a law and differences of its flow at yielding points, with the equivalent trial stress there."""

    law: Any
    slope: np.ndarray
    differences: np.ndarray
    trial: np.ndarray

    @property
    def size(self) -> float:
        """Magnitude of the largest difference."""
        return float(np.abs(self.differences).max(initial=0.0))

    def report(self, size: float) -> tuple[float, str]:
        """Largest error of a slope over ``size``, the largest difference of all points, and a report if it is wrong."""
        if not self.slope.size:
            return 0.0, ""
        wrong = np.abs(self.slope - self.differences) / size
        worst = int(wrong.argmax())
        if not wrong[worst] > SLOPE:
            return float(wrong[worst]), ""
        return float(wrong[worst]), (
            f"the slope of {self.law} is {self.slope[worst]:.3g} under an equivalent trial stress of "
            f"{self.trial[worst]:.3g}, differences of its flow give {self.differences[worst]:.3g}: steps will take "
            "more iterations, or fail. Mend the second value that its flow returns"
        )


def _slopes_of(law: Flow, trial: np.ndarray, cumulated: np.ndarray, mu: float, dt: float) -> _Slopes:
    """Slopes of a law at some points, with central differences of its flow; empty without plastic strain."""
    step = 1e-4
    below, here, above = (flow_of(law, trial * (1 + way * step), cumulated, mu, dt) for way in (-1, 0, 1))
    # the derivative does not exist at first yield
    smooth = (below[0] > 0) & (trial > 0)
    differences = (above[0] - below[0])[smooth] / (2 * step * trial[smooth])
    return _Slopes(law, here[1][smooth], differences, trial[smooth])


@compiled()
def _set_trial(indices, strain, plastic, mu, deviator, equivalent):
    components = strain.shape[1]
    for n in range(indices.size):
        i = indices[n]
        mean = (strain[i, 0] + strain[i, 1] + strain[i, 2]) / 3
        total = 0.0
        for k in range(components):
            value = 2 * mu * (strain[i, k] - plastic[i, k] - (mean if k < 3 else 0.0))
            deviator[n, k] = value
            total += value * value
        equivalent[n] = np.sqrt(1.5 * total)


@compiled()
def _return(indices, strain, deviator, equivalent, amount, slope, bulk, mu, stress, plastic, cumulated, tangents):
    """Radial return; H = bulk 1⊗1 + 2 mu (θ P - (3 mu dΔp/dq - 1 + θ) n⊗n) with θ = 1 - 3 mu Δp / q_tr."""
    components = strain.shape[1]
    for m in range(indices.size):
        i = indices[m]
        q = equivalent[m]
        flow = amount[m]
        mean = bulk * (strain[i, 0] + strain[i, 1] + strain[i, 2])
        theta = 1.0 - 3 * mu * flow / q if flow > 0 else 1.0
        along = 1.5 * flow / q if flow > 0 else 0.0
        for k in range(components):
            stress[i, k] = theta * deviator[m, k] + (mean if k < 3 else 0.0)
            plastic[i, k] += along * deviator[m, k]
        cumulated[i] += flow
        if tangents.size > 0:
            off = 2 * mu * (3 * mu * slope[m] - 1 + theta) * 1.5 / (q * q) if flow > 0 else 0.0
            for k in range(components):
                for j in range(components):
                    value = -off * deviator[m, k] * deviator[m, j]
                    if k == j:
                        value += 2 * mu * theta
                    if k < 3 and j < 3:
                        value += bulk - 2 * mu * theta / 3
                    tangents[i, k, j] = value
