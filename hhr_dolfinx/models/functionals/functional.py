"""Named outputs of a model.

They are numbers that depend on contact forces, on a few rows of the displacement, and on the point.

They are plain data, so that a model file keeps them, and need no field: a model multiplies the rows
with its basis once. Derivatives are exact. At a kink, as a largest value has where two are equal,
they hold on one side only.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, vstack

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.declared import Floats, Integers, Size
from hhr_dolfinx.errors import HHRError, NotOfferedError, ParameterError, SceneError
from hhr_dolfinx.memory import NO_MEMORY, Memory
from hhr_dolfinx.models.shown import table
from hhr_dolfinx.parameters import ParameterSpace

_NOTHING = np.zeros(0)
_NOWHERE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Outputs:
    """Values of the outputs of a scene at one parameter.

    They are read like a mapping from names to numbers.
    """

    values: dict[str, float]  #: by name; NaN without an answer
    units: dict[str, str]  #: as the scene gives them
    #: derivatives along the parameters by name, (P,) each, of outputs that have any; None unless
    #: they were requested
    gradient: dict[str, np.ndarray] | None = None
    one_sided: bool = False  #: whether some of the derivatives hold on one side only
    #: path that values and derivatives belong to, and how far they have converged; empty without
    #: one
    note: str = ""

    def __getitem__(self, name: str) -> float:
        if name not in self.values:
            raise ParameterError(f"there is no output {name!r}: there are {', '.join(self.values)}")
        return self.values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.values)

    def __len__(self) -> int:
        return len(self.values)

    def keys(self) -> list[str]:
        """Names, in the order of the scene."""
        return list(self.values)

    def items(self) -> list[tuple[str, float]]:
        """Names with values, in the order of the scene."""
        return list(self.values.items())

    def facts(self) -> dict[str, str]:
        """Values with their units, by name."""
        return {name: f"{value:.6g} {self.units[name]}".strip() for name, value in self.items()}

    def __str__(self) -> str:
        return "\n".join(f"{name} = {text}" for name, text in self.facts().items())

    def _repr_html_(self) -> str:
        return table("Outputs", self.facts())


class _Gradient(dict[str, np.ndarray]):
    """Derivatives by the names of outputs; only outputs that have any."""

    def __missing__(self, name: str) -> np.ndarray:
        raise NotOfferedError(
            f"output {name!r} has no derivatives along a history: its value is there, or "
            "difference it"
        )


class AllOutputs(ABC):
    """All outputs of a scene; here as they are read if no parameter changes the shape."""

    axes: Any = _NOWHERE  #: indices of the shape parameters
    items: tuple[Functional, ...]  #: one for each output, in the middle of the box
    amplitudes: Amplitudes  #: θ as a function of the parameters

    @abstractmethod
    def at(self, point: np.ndarray) -> Functionals:
        """Outputs on the shape at a point, (P,)."""

    def read(self, here: Functionals, answer: Any, theta: np.ndarray) -> np.ndarray:
        """Rows of the outputs times the displacement of an answer, (K,).

        Args:
            here: outputs on the shape of the answer.
            answer: the answer.
            theta: amplitudes at its parameter, (1 + T,).
        """
        return answer.fields.measured(answer, theta)

    def read_changes(
        self, here: Functionals, answer: Any, changes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all contact forces, (N_lambda, P), and of these products, (K, P).

        Args:
            here: outputs on the shape of the answer.
            answer: the answer, with a gradient.
            changes: derivatives of the amplitudes, (1 + T, P).
        """
        return answer.fields.measured_changes(answer, changes)

    def along_shapes(self, here: Functionals, answer: Any, states: list[State]) -> np.ndarray:
        """Derivatives of all outputs along the shape parameters at fixed states, (outputs, P).

        Args:
            here: outputs on the shape of the answer.
            answer: the answer.
            states: arguments of each output.
        """
        return np.zeros((len(states), answer.parameter.size))


class State(NamedTuple):
    """Arguments of an output."""

    forces: np.ndarray  #: on all contact conditions, (m,); empty if no output needs them
    measured: np.ndarray  #: rows of the output times the displacement, (k,)
    point: np.ndarray  #: the parameter, (P,)
    theta: np.ndarray  #: amplitudes of all terms, (1 + T,)
    stress: Callable[[], np.ndarray]  #: computes the stress where laws of bodies are evaluated
    memory: Memory = NO_MEMORY  #: of the answer


class Slopes(NamedTuple):
    """Partial derivatives of an output."""

    conditions: np.ndarray = _NOWHERE  #: contact conditions whose forces the output depends on
    forces: np.ndarray = _NOTHING  #: along these forces
    measured: np.ndarray = _NOTHING  #: along its rows, (k,)
    theta: np.ndarray = _NOTHING  #: along the amplitudes, (1 + T,), or empty
    point: np.ndarray = _NOTHING  #: along the parameters directly, (P,), or empty
    kink: bool = False  #: whether they hold on one side only


@dataclass(frozen=True, eq=False)
class Functional:
    """An output as numbers."""

    uses_forces: ClassVar[bool] = False  #: whether it depends on contact forces
    differentiable: ClassVar[bool] = True  #: whether it has derivatives along the parameters

    name: str  #: of the output
    unit: str
    count: int  #: k, number of its rows
    rows: Annotated[
        Integers, "entries"
    ]  #: these and the next two: the sparse matrix of its rows, (k, N)
    columns: Annotated[Integers, "entries"]
    entries: Annotated[Floats, "entries"]

    def matrix(self, size: int) -> csr_matrix:
        """Rows of the output, (k, N)."""
        return csr_matrix((self.entries, (self.rows, self.columns)), shape=(self.count, size))

    def value(self, state: State) -> float:
        """Value of the output.

        Raises:
            NotImplementedError: in this base class.
        """
        raise NotImplementedError(
            f"{type(self).__name__} must have value(state), which returns a number"
        )

    def slopes(self, state: State) -> Slopes:
        """Partial derivatives of the output.

        Raises:
            NotImplementedError: in this base class.
        """
        raise NotImplementedError(
            f"{type(self).__name__} must have slopes(state), or differentiable = False"
        )

    def followed(self, state: State, there: Functional, shifted: State) -> float:
        """Value on another shape, on the smooth piece that is active at ``state``.

        Args:
            state: arguments on this shape.
            there: the same output on the other shape.
            shifted: arguments on the other shape.
        """
        return there.value(shifted)

    def indices(self) -> dict[str, np.ndarray]:
        """Indices of ``conditions`` and ``terms``, for checks."""
        return {}


@dataclass(frozen=True, eq=False)
class Functionals(AllOutputs):
    """All outputs of a scene on one shape, (N dofs)."""

    items: tuple[Functional, ...]
    size: Annotated[Size, "N"]
    amplitudes: Amplitudes

    def at(self, point: np.ndarray) -> Functionals:
        """Itself: no parameter changes the shape."""
        return self

    def measured(self, coordinates: np.ndarray) -> np.ndarray:
        """Rows of all outputs times a displacement, (N, ...): (K, ...)."""
        return self.rows @ coordinates

    @cached_property
    def rows(self) -> csr_matrix:
        """Rows of all outputs, concatenated, (K, N)."""
        return csr_matrix(
            vstack([functional.matrix(self.size) for functional in self.items], format="csr")
        )

    @cached_property
    def places(self) -> list[slice]:
        """Rows of each output."""
        ends = np.cumsum([0, *(functional.count for functional in self.items)]).tolist()
        return [slice(*pair) for pair in pairwise(ends)]

    @cached_property
    def uses_forces(self) -> bool:
        """True if any output depends on the contact forces."""
        return any(functional.uses_forces for functional in self.items)

    def check(self, space: ParameterSpace, conditions: int, gauss_points: int) -> None:
        """Check that all parts fit a model: files may be wrong.

        Args:
            space: the box of the parameters.
            conditions: number of contact conditions.
            gauss_points: number of places where laws of bodies are evaluated.

        Raises:
            SceneError: for an output or index that does not fit.
        """
        sizes = {
            "conditions": conditions,
            "terms": self.amplitudes.firsts[-1],
            "points": gauss_points,
        }
        point = space.middle
        for functional in self.items:
            if not isinstance(functional, Functional):
                raise SceneError(f"{functional!r} is no Functional, and an output must be one")
            indices = [
                ("rows", functional.rows, functional.count),
                ("columns", functional.columns, self.size),
            ]
            indices += [(name, index, sizes[name]) for name, index in functional.indices().items()]
            for name, index, size in indices:
                if index.size and not (index.min() >= 0 and index.max() < size):
                    raise SceneError(
                        f"output '{functional.name}' has {name} outside 0 .. {size - 1}"
                    )
            stress = np.zeros((gauss_points, 4))
            tried = State(
                np.ones(conditions),
                np.ones(functional.count),
                point,
                np.ones(sizes["terms"]),
                stress.copy,
            )
            try:
                functional.value(tried)
                functional.matrix(self.size)
            except (ValueError, IndexError) as error:
                raise SceneError(
                    f"output '{functional.name}' has arrays of sizes that do not fit: {error}"
                ) from None


def outputs_of(answer: Any) -> Outputs:
    """Outputs at an answer, with derivatives if the answer has any.

    Raises:
        HHRError: for a model of a scene without outputs.
    """
    fields = answer.fields
    outputs: AllOutputs | None = fields.functionals
    if outputs is None:
        raise HHRError(
            "this model has no outputs: name them in the scene, Scene(..., outputs=(...,)), and "
            "build again"
        )
    units = {functional.name: functional.unit for functional in outputs.items}
    if not answer.converged:
        return Outputs(dict.fromkeys(units, np.nan), units)
    point = answer.parameter
    amplitudes = outputs.amplitudes
    functionals: Functionals = outputs.at(point)
    theta = amplitudes.dense(point)
    forces = fields.forces(answer) if functionals.uses_forces else _NOTHING
    measured = _NOTHING
    if (
        functionals.places and functionals.places[-1].stop
    ):  # outputs of forces alone need no displacement
        measured = outputs.read(functionals, answer, theta)
    context = answer.stress, answer.memory
    states = [State(forces, measured[rows], point, theta, *context) for rows in functionals.places]
    values = {
        functional.name: functional.value(state)
        for functional, state in zip(functionals.items, states, strict=True)
    }
    if answer.gradient is None:
        return Outputs(values, units, note=answer.note)
    acting, slopes = amplitudes.slopes_at(point)
    changes = np.zeros((theta.size, point.size))
    changes[acting] = slopes
    of_forces, of_measured = outputs.read_changes(functionals, answer, changes)
    of_shape = outputs.along_shapes(functionals, answer, states)
    gradient = _Gradient()
    one_sided = answer.gradient.one_sided
    for functional, state, rows, explicit in zip(
        functionals.items, states, functionals.places, of_shape, strict=True
    ):
        if not functional.differentiable:
            continue
        partial = functional.slopes(state)
        derivative = (
            explicit + partial.forces @ of_forces[partial.conditions]
            if partial.conditions.size
            else explicit
        )
        for slope, change in ((partial.measured, of_measured[rows]), (partial.theta, changes)):
            derivative = derivative + slope @ change if slope.size else derivative
        gradient[functional.name] = derivative + partial.point if partial.point.size else derivative
        one_sided = one_sided or partial.kink
    return Outputs(values, units, gradient, one_sided, answer.gradient.note)
