"""Named outputs of a model: numbers that depend on the contact forces, on a few rows of the
displacement, on the point.

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
from hhr_dolfinx.parameters import ParameterSpace

_NOTHING = np.zeros(0)
_NOWHERE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Outputs:
    """Values of the outputs of a scene at one parameter; read like a mapping from names to
    numbers.
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


class _Gradient(dict[str, np.ndarray]):
    """Derivatives by the names of outputs; only outputs that have any."""

    def __missing__(self, name: str) -> np.ndarray:
        raise NotOfferedError(
            f"output {name!r} has no derivatives along a history: its value is there, or "
            "difference it"
        )


class AllOutputs(ABC):
    """All outputs of a scene; here as they are read where no parameter changes the shape."""

    axes: Any = _NOWHERE  #: indices of the shape parameters
    items: tuple[Functional, ...]  #: one for each output, in the middle of the box
    amplitudes: Amplitudes  #: θ as a function of the parameters

    @abstractmethod
    def at(self, point: np.ndarray) -> Functionals:
        """Outputs on the shape at a point, (P,)."""

    def read(self, here: Functionals, answer: Any, theta: np.ndarray) -> np.ndarray:
        """Rows of the outputs ``here`` times the displacement of an answer, (K,)."""
        return answer.fields.measured(answer, theta)

    def read_changes(
        self, here: Functionals, answer: Any, changes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all contact forces, (N_lambda, P), and of these products, (K, P)."""
        return answer.fields.measured_changes(answer, changes)

    def along_shapes(self, here: Functionals, answer: Any, states: list[State]) -> np.ndarray:
        """Derivatives of all outputs along the shape parameters at fixed states, (outputs, P)."""
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
        """Its rows, (k, N)."""
        return csr_matrix((self.entries, (self.rows, self.columns)), shape=(self.count, size))

    def value(self, state: State) -> float:
        """Value of the output."""
        raise NotImplementedError(
            f"{type(self).__name__} must have value(state), which returns a number"
        )

    def slopes(self, state: State) -> Slopes:
        """Partial derivatives of the output."""
        raise NotImplementedError(
            f"{type(self).__name__} must have slopes(state), or differentiable = False"
        )

    def followed(self, state: State, there: Functional, shifted: State) -> float:
        """Value of the same output on another shape, on the smooth piece that is active at
        ``state``.
        """
        return there.value(shifted)

    def indices(self) -> dict[str, np.ndarray]:
        """Its indices of ``conditions`` and ``terms``, for checks."""
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
        return csr_matrix(vstack([item.matrix(self.size) for item in self.items], format="csr"))

    @cached_property
    def places(self) -> list[slice]:
        """Rows of each output."""
        ends = np.cumsum([0, *(item.count for item in self.items)]).tolist()
        return [slice(*pair) for pair in pairwise(ends)]

    @cached_property
    def uses_forces(self) -> bool:
        """True if any output depends on the contact forces."""
        return any(item.uses_forces for item in self.items)

    def check(self, space: ParameterSpace, conditions: int, gauss_points: int) -> None:
        """Raise SceneError for parts that do not fit a model; files may be wrong."""
        sizes = {
            "conditions": conditions,
            "terms": self.amplitudes.firsts[-1],
            "points": gauss_points,
        }
        point = space.middle
        for item in self.items:
            if not isinstance(item, Functional):
                raise SceneError(f"{item!r} is no Functional, and an output must be one")
            own = [("rows", item.rows, item.count), ("columns", item.columns, self.size)]
            own += [(what, index, sizes[what]) for what, index in item.indices().items()]
            for what, index, size in own:
                if index.size and not (index.min() >= 0 and index.max() < size):
                    raise SceneError(f"output '{item.name}' has {what} outside 0 .. {size - 1}")
            stress = np.zeros((gauss_points, 4))
            tried = State(
                np.ones(conditions),
                np.ones(item.count),
                point,
                np.ones(sizes["terms"]),
                stress.copy,
            )
            try:
                item.value(tried)
                item.matrix(self.size)
            except (ValueError, IndexError) as error:
                raise SceneError(
                    f"output '{item.name}' has arrays of sizes that do not fit: {error}"
                ) from None


def outputs_of(answer: Any) -> Outputs:
    """Outputs at an answer, with derivatives if the answer has any.

    HHRError for a model of a scene without outputs.
    """
    fields: Any = answer.fields
    whole: Any = fields.functionals
    if whole is None:
        raise HHRError(
            "this model has no outputs: name them in the scene, Scene(..., outputs=(...,)), and "
            "build again"
        )
    units = {item.name: item.unit for item in whole.items}
    if not answer.converged:
        return Outputs(dict.fromkeys(units, np.nan), units)
    point = answer.parameter
    amplitudes = whole.amplitudes
    functionals: Functionals = whole.at(point)
    theta = amplitudes.dense(point)
    forces = fields.forces(answer) if functionals.uses_forces else _NOTHING
    measured = _NOTHING
    if (
        functionals.places and functionals.places[-1].stop
    ):  # outputs of forces alone need no displacement
        measured = whole.read(functionals, answer, theta)
    rest = answer.stress, answer.memory
    states = [State(forces, measured[place], point, theta, *rest) for place in functionals.places]
    values = {
        item.name: item.value(state) for item, state in zip(functionals.items, states, strict=True)
    }
    if answer.gradient is None:
        return Outputs(values, units, note=answer.note)
    acting, slopes = amplitudes.slopes_at(point)
    changes = np.zeros((theta.size, point.size))
    changes[acting] = slopes
    of_forces, of_measured = whole.read_changes(functionals, answer, changes)
    of_shape = whole.along_shapes(functionals, answer, states)
    gradient = _Gradient()
    one_sided = answer.gradient.one_sided
    for item, state, place, explicit in zip(
        functionals.items, states, functionals.places, of_shape, strict=True
    ):
        if not item.differentiable:
            continue
        part = item.slopes(state)
        found = (
            explicit + part.forces @ of_forces[part.conditions]
            if part.conditions.size
            else explicit
        )
        for slope, change in ((part.measured, of_measured[place]), (part.theta, changes)):
            found = found + slope @ change if slope.size else found
        gradient[item.name] = found + part.point if part.point.size else found
        one_sided = one_sided or part.kink
    return Outputs(values, units, gradient, one_sided, answer.gradient.note)
