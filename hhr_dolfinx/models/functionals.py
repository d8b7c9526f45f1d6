"""Named outputs of a model: numbers that depend on the contact forces, on a few rows of the displacement, on the point.

They are plain data, so that a model file keeps them, and are read without a field: a model multiplies the rows with its
basis once. Derivatives are exact; where an output has a kink, as a largest value has where two are equal, they hold on
one side only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, vstack

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.errors import HHRError, SceneError
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.materials.elasticity import von_mises

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer

TIE = 1e-9
"""Relative difference below which two values are both the largest, and the derivative holds on one side only."""
LOADED = 1e-3
"""Part of the largest pressure of a contact from which on a condition is under load: below it forces that a reduced
model completes outside its domain are noise."""
_NOTHING = np.zeros(0)
_NOWHERE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Outputs:
    """Values of the outputs of a scene at one parameter; read like a mapping from names to numbers.

    Attributes:
        values: by name; NaN without an answer.
        units: as the scene gives them.
        gradient: derivatives along the parameters by name, (P,) each; None unless they were asked for.
        one_sided: whether some of the derivatives hold on one side only.
    """

    values: dict[str, float]
    units: dict[str, str]
    gradient: dict[str, np.ndarray] | None = None
    one_sided: bool = False

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.values)

    def __len__(self) -> int:
        return len(self.values)

    def keys(self) -> list[str]:
        """Names, in the order of the scene."""
        return list(self.values)


class State(NamedTuple):
    """What an output is a function of.

    Attributes:
        forces: on all contact conditions, (m,); nothing where no output asks.
        measured: rows of the output times the displacement, (k,).
        point: the parameter, (P,).
        theta: amplitudes of all terms, (1 + T,).
        stress: makes the stress at all Gauss points, where bodies flow.
    """

    forces: np.ndarray
    measured: np.ndarray
    point: np.ndarray
    theta: np.ndarray
    stress: Callable[[], np.ndarray]


class Slopes(NamedTuple):
    """Partial derivatives of an output.

    Attributes:
        conditions: contact conditions on whose forces it depends.
        forces: along these forces.
        measured: along its rows, (k,).
        theta: along the amplitudes, (1 + T,), or nothing.
        point: along the parameters by themselves, (P,), or nothing.
        kink: whether they hold on one side only.
    """

    conditions: np.ndarray = _NOWHERE
    forces: np.ndarray = _NOTHING
    measured: np.ndarray = _NOTHING
    theta: np.ndarray = _NOTHING
    point: np.ndarray = _NOTHING
    kink: bool = False


@dataclass(frozen=True, eq=False)
class Functional:
    """An output as numbers.

    Attributes:
        name, unit: of the output.
        count: k, number of its rows.
        rows, columns, entries: of the sparse matrix of its rows, (k, N).
    """

    uses_forces: ClassVar[bool] = False

    name: str
    unit: str
    count: int
    rows: np.ndarray
    columns: np.ndarray
    entries: np.ndarray

    def matrix(self, size: int) -> csr_matrix:
        """Its rows, (k, N)."""
        return csr_matrix((self.entries, (self.rows, self.columns)), shape=(self.count, size))

    def value(self, state: State) -> float:
        """Its value."""
        raise NotImplementedError

    def slopes(self, state: State) -> Slopes:
        """Its partial derivatives."""
        raise NotImplementedError

    def indices(self) -> dict[str, np.ndarray]:
        """Its indices of ``conditions`` and ``terms``, to be checked."""
        return {}


@dataclass(frozen=True, eq=False)
class Linear(Functional):
    """Forces, displacement and amplitudes times weights.

    Attributes:
        conditions, weights: of the forces, (c,) each.
        along: weights of its rows, (k,).
        terms, coefficients: of the amplitudes, (t,) each.
    """

    conditions: np.ndarray
    weights: np.ndarray
    along: np.ndarray
    terms: np.ndarray
    coefficients: np.ndarray

    @property
    def uses_forces(self) -> bool:  # type: ignore[override]
        """Whether it depends on any."""
        return self.conditions.size > 0

    def value(self, state: State) -> float:
        """The sum of all products."""
        value = state.measured @ self.along + state.theta[self.terms] @ self.coefficients
        return float(value + state.forces[self.conditions] @ self.weights if self.uses_forces else value)

    def slopes(self, state: State) -> Slopes:
        """The weights."""
        theta = np.zeros(state.theta.size)
        theta[self.terms] = self.coefficients
        return Slopes(self.conditions, self.weights, self.along, theta)

    def indices(self) -> dict[str, np.ndarray]:
        """Conditions and terms."""
        return {"conditions": self.conditions, "terms": self.terms}


@dataclass(frozen=True, eq=False)
class Largest(Functional):
    """Largest pressure, force over area.

    Attributes:
        conditions, areas: (c,) each.
    """

    uses_forces: ClassVar[bool] = True

    conditions: np.ndarray
    areas: np.ndarray

    def value(self, state: State) -> float:
        """Of any condition."""
        return float((state.forces[self.conditions] / self.areas).max())

    def slopes(self, state: State) -> Slopes:
        """Of the condition where it is attained."""
        pressures = state.forces[self.conditions] / self.areas
        place = pressures.argmax()
        return Slopes(self.conditions[[place]], 1 / self.areas[[place]], kink=_tied(pressures, place))

    def indices(self) -> dict[str, np.ndarray]:
        """Conditions."""
        return {"conditions": self.conditions}


@dataclass(frozen=True, eq=False)
class Loaded(Functional):
    """Area under load times a factor and an offset; piecewise constant, so that its derivatives are zero.

    Attributes:
        conditions, areas: (c,) each.
        offset, factor: what its value is made of.
    """

    uses_forces: ClassVar[bool] = True

    conditions: np.ndarray
    areas: np.ndarray
    offset: float
    factor: float

    def value(self, state: State) -> float:
        """By what is pressed by more than :data:`LOADED` of the largest pressure."""
        pressures = state.forces[self.conditions] / self.areas
        largest = pressures.max()
        loaded = (pressures > LOADED * largest) & (largest > 0)
        return float(self.offset + self.factor * self.areas[loaded].sum())

    def slopes(self, state: State) -> Slopes:
        """None."""
        return Slopes()

    def indices(self) -> dict[str, np.ndarray]:
        """Conditions."""
        return {"conditions": self.conditions}


@dataclass(frozen=True, eq=False)
class Mises(Functional):
    """Von Mises' stress of elastic cells: rows are the strain in their middles, Kelvin's notation, cell by cell.

    Attributes:
        names: of the parameters.
        volume, shape: λ' and μ' as formulas, see :func:`hhr_dolfinx.forms.elasticity.isotropic_parts`.
        plane_stress: whether the stress across the plane vanishes.
        grading: factor of the moduli of each cell, (cells,).
        shares: of each cell in the mean, (cells,); none for the largest value.
    """

    names: tuple[str, ...]
    volume: str
    shape: str
    plane_stress: bool
    grading: np.ndarray
    shares: np.ndarray

    def __post_init__(self) -> None:
        _ = self._moduli  # what cannot be read is refused where it is made

    @cached_property
    def _moduli(self) -> tuple[Scalar, Scalar]:
        return Scalar(self.volume, tuple(self.names)), Scalar(self.shape, tuple(self.names))

    def _stress(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Stress and its parts per λ' and μ', (cells, components) each, and the unit tensor, (components,)."""
        strain = state.measured.reshape(self.grading.size, -1)
        if self.plane_stress:
            strain = strain * np.array([1.0, 1.0, 0.0, 1.0])
        unit = np.zeros(strain.shape[1])
        unit[: 2 if self.plane_stress else 3] = 1.0
        of_volume = self.grading[:, None] * np.outer(strain @ unit, unit)
        of_shape = 2 * self.grading[:, None] * strain
        volume, shape = (modulus.value(state.point) for modulus in self._moduli)
        return volume * of_volume + shape * of_shape, of_volume, of_shape, unit

    def value(self, state: State) -> float:
        """The largest one, or their mean over the volume."""
        values = von_mises(self._stress(state)[0])
        return float(self.shares @ values if self.shares.size else values.max())

    def slopes(self, state: State) -> Slopes:
        """Through the stress."""
        stress, of_volume, of_shape, unit = self._stress(state)
        values = von_mises(stress)
        shares, kink = self.shares, False
        if not shares.size:
            shares = np.zeros(values.size)
            shares[values.argmax()] = 1.0
            kink = _tied(values, int(values.argmax()))
        deviator = stress.copy()
        deviator[:, :3] -= stress[:, :3].mean(axis=1, keepdims=True)
        scale = np.divide(1.5 * shares, values, out=np.zeros(values.size), where=values > 0)
        along = scale[:, None] * deviator
        volume, shape = self._moduli
        found = volume.value(state.point) * np.outer(along @ unit, unit) + 2 * shape.value(state.point) * along
        found *= self.grading[:, None]
        if self.plane_stress:
            found *= np.array([1.0, 1.0, 0.0, 1.0])
        point = np.sum(along * of_volume) * volume.derivative(state.point)
        point = point + np.sum(along * of_shape) * shape.derivative(state.point)
        return Slopes(measured=found.ravel(), point=point, kink=kink or bool((values[shares > 0] == 0).any()))


@dataclass(frozen=True, eq=False)
class FlowMises(Functional):
    """Von Mises' stress at Gauss points of bodies that flow.

    Attributes:
        points: numbers of the Gauss points, (g,).
        shares: of each in the mean, (g,); none for the largest value.
    """

    points: np.ndarray
    shares: np.ndarray

    def value(self, state: State) -> float:
        """The largest one, or their mean over the volume."""
        values = von_mises(state.stress()[self.points])
        return float(self.shares @ values if self.shares.size else values.max())


@dataclass(frozen=True, eq=False)
class Energy(Functional):
    """Elastic energy by the work of all forces: (U0·F θ + U0·K lift + lift·K lift - λ·D θ) / 2.

    It is u·K u / 2 in equilibrium, since K U0 = F - K lift - B^T λ, and B U0 = D wherever λ is not zero.

    Attributes:
        names: of the parameters.
        moduli: of the parts of K, as formulas.
        terms: of θ by which each row is multiplied, (k,).
        parts: number of the modulus of each row, (k,); -1 for a load, which has none.
        lifted: terms that impose displacements, (l,).
        lifts: lift·K_q lift of each part, (Q, l, l).
        gap_terms: terms on which gaps depend, (g,).
        gaps: D, (m, g).
    """

    uses_forces: ClassVar[bool] = True

    names: tuple[str, ...]
    moduli: tuple[str, ...]
    terms: np.ndarray
    parts: np.ndarray
    lifted: np.ndarray
    lifts: np.ndarray
    gap_terms: np.ndarray
    gaps: np.ndarray

    def __post_init__(self) -> None:
        _ = self._moduli

    @cached_property
    def _moduli(self) -> tuple[Scalar, ...]:
        return tuple(Scalar(text, tuple(self.names)) for text in self.moduli)

    def value(self, state: State) -> float:
        """Half the work."""
        weights = np.array([*(modulus.value(state.point) for modulus in self._moduli), 1.0])
        theta, moved = state.theta, state.theta[self.lifted]
        work = (theta[self.terms] * weights[self.parts]) @ state.measured
        work += weights[:-1] @ (self.lifts @ moved @ moved)
        return float(work - state.forces @ (self.gaps @ theta[self.gap_terms])) / 2

    def slopes(self, state: State) -> Slopes:
        """Product by product."""
        weights = np.array([*(modulus.value(state.point) for modulus in self._moduli), 1.0])
        theta, moved = state.theta, state.theta[self.lifted]
        of_theta = np.zeros(theta.size)
        np.add.at(of_theta, self.terms, weights[self.parts] * state.measured)
        np.add.at(of_theta, self.lifted, 2 * np.tensordot(weights[:-1], self.lifts, 1) @ moved)
        np.add.at(of_theta, self.gap_terms, -(state.forces @ self.gaps))
        of_weights = self.lifts @ moved @ moved
        inner = self.parts >= 0
        np.add.at(of_weights, self.parts[inner], (theta[self.terms] * state.measured)[inner])
        point = np.zeros(state.point.size)
        for modulus, slope in zip(self._moduli, of_weights, strict=True):
            point += slope * modulus.derivative(state.point)
        of_forces = -(self.gaps @ theta[self.gap_terms]) / 2
        every = np.arange(state.forces.size)
        return Slopes(every, of_forces, theta[self.terms] * weights[self.parts] / 2, of_theta / 2, point / 2)

    def indices(self) -> dict[str, np.ndarray]:
        """Terms."""
        return {"terms": np.concatenate([self.terms, self.lifted, self.gap_terms])}


KINDS = (Linear, Largest, Loaded, Mises, FlowMises, Energy)
"""All of them, as a model file may hold."""


@dataclass(frozen=True, eq=False)
class Functionals:
    """All outputs of a scene.

    Attributes:
        items: one for each output.
        size: N, number of dofs.
        amplitudes: θ as a function of the parameters.
    """

    items: tuple[Functional, ...]
    size: int
    amplitudes: Amplitudes

    @cached_property
    def rows(self) -> csr_matrix:
        """Rows of all outputs, one behind another, (K, N)."""
        return csr_matrix(vstack([item.matrix(self.size) for item in self.items], format="csr"))

    @cached_property
    def places(self) -> list[slice]:
        """Rows of each."""
        ends = np.cumsum([0, *(item.count for item in self.items)]).tolist()
        return [slice(*pair) for pair in zip(ends[:-1], ends[1:], strict=True)]

    @cached_property
    def uses_forces(self) -> bool:
        """Whether any depends on the contact forces."""
        return any(item.uses_forces for item in self.items)

    def check(self, conditions: int) -> None:
        """Raise SceneError for indices out of range; what was read may hold any."""
        sizes = {"conditions": conditions, "terms": self.amplitudes.firsts[-1]}
        for item in self.items:
            own = [("rows", item.rows, item.count), ("columns", item.columns, self.size)]
            own += [(what, index, sizes[what]) for what, index in item.indices().items()]
            for what, index, size in own:
                if index.size and not (index.min() >= 0 and index.max() < size):
                    raise SceneError(f"output '{item.name}' has {what} outside 0 .. {size - 1}")


def outputs_of(answer: Answer) -> Outputs:
    """Outputs at an answer, with derivatives if the answer has any.

    Raises:
        HHRError: for a model of a scene without outputs.
    """
    fields = answer.fields
    functionals = getattr(fields, "functionals", None)
    if functionals is None:
        raise HHRError("this model has no outputs: name them in the scene, Scene(..., outputs=(...,)), and build again")
    units = {item.name: item.unit for item in functionals.items}
    if not answer.converged:
        return Outputs(dict.fromkeys(units, np.nan), units)
    point, amplitudes = answer.parameter, functionals.amplitudes
    given = amplitudes(point)
    theta = np.zeros(amplitudes.firsts[-1])
    theta[given.terms] = given.values
    forces = fields.forces(answer) if functionals.uses_forces else _NOTHING
    measured = fields.measured(answer, theta)
    states = [State(forces, measured[place], point, theta, answer.stress) for place in functionals.places]
    values = {item.name: item.value(state) for item, state in zip(functionals.items, states, strict=True)}
    if answer.gradient is None:
        return Outputs(values, units)
    acting, slopes = amplitudes.slopes_at(point)
    changes = np.zeros((theta.size, point.size))
    changes[acting] = slopes
    of_forces, of_measured = fields.measured_changes(answer, changes)
    gradient, one_sided = {}, answer.gradient.one_sided
    for item, state, place in zip(functionals.items, states, functionals.places, strict=True):
        part = item.slopes(state)
        found = part.forces @ of_forces[part.conditions] if part.conditions.size else np.zeros(point.size)
        for slope, change in ((part.measured, of_measured[place]), (part.theta, changes)):
            found = found + slope @ change if slope.size else found
        gradient[item.name] = found + part.point if part.point.size else found
        one_sided = one_sided or part.kink
    return Outputs(values, units, gradient, one_sided)


def _tied(values: np.ndarray, place: int) -> bool:
    """Whether another value is as large as the largest, or all are zero."""
    largest = values[place]
    return bool(np.count_nonzero(values >= largest - TIE * abs(largest)) > 1)
