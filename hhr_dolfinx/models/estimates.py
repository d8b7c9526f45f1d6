"""Errors of answers: estimates for one answer, and for many at once.

Norms, with σ = λ / area the nodal pressure, zero of a condition without an area:

    displacement      (v^T K v)^1/2, energy
    forces in energy  (λ^T S λ)^1/2, the energy of the displacement of the forces alone
    forces            (λ^T λ)^1/2, Euclidean, of nodal forces
    pressure          max σ_i, the largest

A relative error of forces and pressures is the error over the exact norm, or over a thousandth of
the largest one in training if the exact norm is smaller: if contact is nearly lost a relative error
is meaningless.

``known_error`` describes the errors that a model estimates in one line, ``relative_error`` returns
a selected one. Both depend only on the fields of answers, so that they apply to all kinds of
models.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hhr_dolfinx.errors import NoBoundWarning, ParameterError
from hhr_dolfinx.models.shown import table
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.models.functionals.functional import AllOutputs

NO_OUTPUTS: Mapping[str, float] = {}
"""Outputs of a model without outputs, or without estimates of them."""
ESTIMATE_NUMBERS = tuple(
    "primal dual primal_relative dual_relative "
    "forces_euclid pressure forces_euclid_relative pressure_relative".split()
)
"""Attributes of an estimate that do not belong to outputs."""
RELATIVE_ERRORS = {
    "displacement": "primal_relative",
    "forces": "forces_euclid_relative",
    "pressure": "pressure_relative",
    "forces in energy": "dual_relative",
}
"""Relative errors by their names for users."""
STRESS_INDICATOR = "indicator of the stress"
"""Kind of the estimates of laws of bodies, which cover only the stress."""
FORCES_INDICATOR = "indicator of the forces"
"""Kind of the estimates of hyper-reduced laws of interfaces, which cover only forces."""


class Estimate(NamedTuple):
    """Estimate of the error of an answer.

    Attributes:
        kind: ``bound``, which no error exceeds: the error itself, up to round-off, for a constant
            stiffness; ``estimate``, a bound except for an interpolation without a proof;
            ``indicator``, which follows the error; :data:`STRESS_INDICATOR`, which follows that
            of the stress alone, relative to the stress of the same step; or
            :data:`FORCES_INDICATOR`, the same for the Euclidean norm of forces.
        primal: of the displacement in energy, (v^T K v)^1/2.
        dual: of the contact forces in the S norm, (λ^T S λ)^1/2: the energy of the displacement of
            the forces alone. Indicators have no units: this and all other absolute errors are then
            infinite.
        primal_relative, dual_relative: over the smallest possible norm of the exact answer;
            infinite if a bound is larger than the answer itself.
        outputs: errors of the outputs of the scene, by name; outputs without an estimate are left
            out, see :class:`~hhr_dolfinx.models.bound.OutputBound`.
        forces_euclid: of the nodal contact forces in the Euclidean norm.
        pressure: the largest error of a nodal pressure.
        forces_euclid_relative, pressure_relative: over the Euclidean norm of the exact forces, and
            over the exact peak pressure.
    """

    kind: str
    primal: float
    dual: float
    primal_relative: float
    dual_relative: float
    outputs: Mapping[str, float] = NO_OUTPUTS
    forces_euclid: float = math.inf
    pressure: float = math.inf
    forces_euclid_relative: float = math.inf
    pressure_relative: float = math.inf

    @classmethod
    def indicated(cls, value: float, kind: str = "indicator") -> Estimate:
        """Estimate by an indicator, as a relative error; errors of pressures are infinite.

        Args:
            value: relative error, not negative.
            kind: ``indicator``, :data:`STRESS_INDICATOR` or :data:`FORCES_INDICATOR`.

        Raises:
            ParameterError: for a value that is no relative error: not a number, NaN, or negative.
        """
        if not (isinstance(value, Real) and value >= 0):
            raise ParameterError(
                f"an indicator says {value!r}: it must be a relative error, a number from 0 on"
            )
        value = float(value)
        if kind == FORCES_INDICATOR:
            return cls(kind, math.inf, math.inf, math.inf, math.inf, forces_euclid_relative=value)
        # an indicator of the stress says nothing about forces: these errors are infinite
        forces = math.inf if kind == STRESS_INDICATOR else value
        return cls(kind, math.inf, math.inf, value, value, forces_euclid_relative=forces)

    @classmethod
    def exact(cls, functionals: AllOutputs | None) -> Estimate:
        """Estimate of an answer without an error, with the outputs of a scene, or None."""
        outputs = () if functionals is None else functionals.items
        return cls(
            "bound",
            0.0,
            0.0,
            0.0,
            0.0,
            {output.name: 0.0 for output in outputs},
            0.0,
            0.0,
            0.0,
            0.0,
        )

    def _repr_html_(self) -> str:
        errors = self.shown({name: name for name in self.outputs})
        shown = {name: f"{value:.3g}" for name, value in errors.items()}
        return table("Relative errors, of outputs absolute ones", shown)

    def shown(self, outputs: Mapping[str, str] = MappingProxyType({})) -> dict[str, float]:
        """Row of a table, by the heads of :func:`columns`; NaN for outputs without a bound."""
        values = [float(getattr(self, name)) for name in shown_of(self.kind).values()]
        if not self.kind.startswith("indicator"):
            values += [self.outputs.get(name, math.nan) for name in outputs]
        return dict(zip(columns(self.kind, outputs), values, strict=True))


@dataclass(frozen=True)
class Estimates:
    """Estimates of many answers; ``estimates[k]`` is the :class:`Estimate` of one.

    Attributes:
        kind: see there.
        primal, dual, primal_relative, dual_relative, forces_euclid, pressure,
        forces_euclid_relative,
            pressure_relative: see there, (n,) each; NaN without an answer.
        outputs_of: returns the bounds of the outputs of one answer, by its number; called when they
            are read.
    """

    kind: str
    primal: np.ndarray
    dual: np.ndarray
    primal_relative: np.ndarray
    dual_relative: np.ndarray
    forces_euclid: np.ndarray
    pressure: np.ndarray
    forces_euclid_relative: np.ndarray
    pressure_relative: np.ndarray
    outputs_of: Callable[[int], Mapping[str, float]] = field(
        default=lambda _: NO_OUTPUTS, compare=False
    )

    @classmethod
    def by_blocks(
        cls,
        kind: str,
        solved: np.ndarray,
        together: int,
        bounded: Callable[[np.ndarray], Estimates],
    ) -> Estimates:
        """Estimates of the converged answers, in blocks of rows; NaN for the others.

        Args:
            kind: kind of the estimates, see :class:`Estimate`.
            solved: True for each converged answer, (n,) bool.
            together: rows of a block.
            bounded: returns the estimates of some rows, by their numbers.
        """
        rows = np.flatnonzero(solved)
        blocks = [rows[first : first + together] for first in range(0, rows.size, together)]
        return cls._filled({kind}, len(solved), [(block, bounded(block)) for block in blocks])

    def __len__(self) -> int:
        return len(self.primal)

    def __reduce__(self) -> tuple[type[Estimates], tuple[object, ...]]:
        """Copy and pickle with the bounds of all outputs."""
        bounds = [dict(self.outputs_of(k)) for k in range(len(self))]
        return Estimates, (
            self.kind,
            *(getattr(self, name) for name in ESTIMATE_NUMBERS),
            bounds.__getitem__,
        )

    def __getitem__(self, k: int) -> Estimate:
        numbers = {name: float(getattr(self, name)[k]) for name in ESTIMATE_NUMBERS}
        return Estimate(self.kind, outputs=self.outputs_of(k), **numbers)

    @classmethod
    def of(cls, found: Sequence[Estimate | None]) -> Estimates | None:
        """Join estimates of single answers; None if there are none."""
        rows = [
            (np.arange(k, k + 1), estimate)
            for k, estimate in enumerate(found)
            if estimate is not None
        ]
        kinds = {estimate.kind for _, estimate in rows}
        if not kinds:
            return None
        bounds = [NO_OUTPUTS if estimate is None else estimate.outputs for estimate in found]
        return replace(cls._filled(kinds, len(found), rows), outputs_of=bounds.__getitem__)

    @classmethod
    def joined(
        cls, parts: Sequence[tuple[np.ndarray, Estimates | None]], count: int
    ) -> Estimates | None:
        """Join estimates of parts of many answers; None without any.

        Args:
            parts: indices and estimates of the answers of each part.
            count: number of all answers.
        """
        estimated = [(rows, estimates) for rows, estimates in parts if estimates is not None]
        if not estimated:
            return None
        sources = {
            row: (estimates, k)
            for rows, estimates in estimated
            for k, row in enumerate(np.arange(count)[rows].tolist())
        }

        def outputs_of(row: int) -> Mapping[str, float]:
            estimates, k = sources.get(row, (None, 0))
            return NO_OUTPUTS if estimates is None else estimates.outputs_of(k)

        return replace(
            cls._filled({estimates.kind for _, estimates in estimated}, count, estimated),
            outputs_of=outputs_of,
        )

    @classmethod
    def _filled(
        cls, kinds: set[str], count: int, parts: Sequence[tuple[np.ndarray, Estimate | Estimates]]
    ) -> Estimates:
        """Estimates with attributes at some indices, NaN elsewhere."""
        numbers = np.full((len(ESTIMATE_NUMBERS), count), np.nan)
        for rows, estimates in parts:
            for row, name in zip(numbers, ESTIMATE_NUMBERS, strict=True):
                row[rows] = getattr(estimates, name)
        return cls(" and ".join(sorted(kinds)), *numbers)


def shown_of(kind: str) -> dict[str, str]:
    """Names of the attributes that estimates of a kind show, by the heads of their columns."""
    if kind == STRESS_INDICATOR:
        return {STRESS_INDICATOR: "primal_relative"}
    if kind == FORCES_INDICATOR:
        return {FORCES_INDICATOR: "forces_euclid_relative"}
    names = ("displacement", "forces") if kind == "indicator" else tuple(RELATIVE_ERRORS)
    return {f"{kind} of {name}": RELATIVE_ERRORS[name] for name in names}


def columns(kind: str, outputs: Mapping[str, str]) -> list[str]:
    """Column heads of a table for the estimates.

    Args:
        kind: see :class:`Estimate`.
        outputs: heads of the outputs that are bounded, by name.
    """
    bounded = () if kind.startswith("indicator") else outputs.values()
    return [*shown_of(kind), *(f"{kind} of {name}" for name in bounded)]


HOW = {
    "bound": "bound, proved",
    "estimate": "estimate, since the interpolation between parameters is observed and not proved",
}
"""Descriptions of the kinds of estimates."""
NOT_ASKED = "the recipe asks for none"
"""Reason for a missing bound in a model built without one."""
NORMS = "the displacement in energy; nodal contact forces, Euclidean and in energy; pressures"
FALLBACK_ERRORS = ("forces", "pressure", "displacement")
"""Errors that may trigger a fall-back, in addition to those of outputs."""


def known_error(fields: Any) -> str:
    """Description of the errors that are estimated, or the reason why there are none.

    The argument are the fields of answers.
    """
    kind = fields.estimated
    if fields.bound is not None:
        bounded, unbounded = _outputs(fields)
        outputs = f"; outputs {', '.join(bounded)}" if bounded else ""
        return f"{HOW[kind]}: {NORMS}{outputs}" + (
            f". No bound of {', '.join(unbounded)}" if unbounded else ""
        )
    if fields.indicator is not None:
        return "indicator of the recipe: follows errors as far as it is made to, without a proof"
    if fields.flow is not None:
        return str(fields.flow.known_error)
    if kind == FORCES_INDICATOR:
        return (
            "indicator of the forces: the part of those on the RID that no training explains; "
            "without a proof"
        )
    if fields.exact:
        return f"exact: {fields.unbounded}"
    return f"none: {fields.unbounded or 'answers of this kind estimate no errors'}"


def _outputs(fields: Any) -> tuple[list[str], list[str]]:
    """Names of the outputs with a bound, and of those without."""
    functionals = () if fields.functionals is None else fields.functionals.items
    bounds = fields.output_bound
    bounded = [
        functional.name
        for functional in functionals
        if bounds is not None and bounds.knows(functional)
    ]
    return bounded, [
        functional.name for functional in functionals if functional.name not in bounded
    ]


def warn_unbounded(fields: Any) -> None:
    """Warn if bounds were requested and the model has none: its errors remain unknown."""
    reason = fields.unbounded
    if reason and reason != NOT_ASKED and fields.bound is None:
        warn(
            f"nothing is known of the errors of these answers: {reason}. They were compared with "
            "answers held out, and may be far off between them: hold out more, or ask the full "
            "model where it counts",
            NoBoundWarning,
        )


def check_asked(fields: Any, of: str | None) -> None:
    """Check an error by its name.

    Args:
        fields: fields of the model.
        of: None, one of :data:`FALLBACK_ERRORS`, or the name of an output with a bound.

    Raises:
        ParameterError: for another name, or an output without a bound, with the reason.
    """
    if fields.estimated == FORCES_INDICATOR:
        check_of_forces(of)
    bounded, unbounded = _outputs(fields)
    check_word([*bounded, *unbounded], of)
    if of in unbounded and of not in FALLBACK_ERRORS:
        reason = "it reads more of the displacement than there is room for"
        if fields.output_bound is None:
            reason = (
                "outputs have one only where the stiffness does not depend on parameters and all "
                "bodies are held"
            )
        raise ParameterError(
            f"there is no estimate of the error of output {of!r}: {reason}. Take "
            f"{', '.join([*FALLBACK_ERRORS, *bounded])}"
        )


def check_of_forces(of: str | None) -> None:
    """Check that the indicator of forces of a hyper-reduced model covers an error.

    Raises:
        ParameterError: for another error than ``forces``.
    """
    if of != "forces":
        raise ParameterError(
            f"of = {of!r}: the hyper-reduced model has an indicator of its forces, by the law of "
            "its contacts, and nothing else is known of its errors: ask for of='forces'"
        )


def check_word(outputs: Sequence[str], of: str | None) -> None:
    """Check the name of an error.

    Args:
        outputs: names of the outputs.
        of: None, one of :data:`FALLBACK_ERRORS`, or the name of an output.

    Raises:
        ParameterError: for another name.
    """
    if of is not None and not (isinstance(of, str) and of in (*FALLBACK_ERRORS, *outputs)):
        raise ParameterError(
            f"of = {of!r} is no error that is known here: give "
            f"{', '.join(repr(word) for word in (*FALLBACK_ERRORS, *outputs))}, or None "
            f"for displacement "
            "and forces in energy"
        )


def relative_error(answer: Any, estimate: Estimate, of: str | None) -> float:
    """The selected error of an estimate, relative to the exact answer.

    Args:
        answer: its value is the denominator for an output.
        estimate: of its error.
        of: see :func:`check_asked`; None selects the larger one of displacement and forces, both in
            energy.
    """
    if of is None:
        # with a NaN no comparison is true
        worst = (estimate.primal_relative, estimate.dual_relative)
        return math.nan if any(map(math.isnan, worst)) else max(worst)
    if of in RELATIVE_ERRORS:
        return float(getattr(estimate, RELATIVE_ERRORS[of]))
    error = estimate.outputs.get(of, math.inf)
    if error == 0:  # for exact answers too, which have no bounds
        return 0.0
    if answer.fields.output_bound is None:
        return math.inf
    size = max(
        abs(answer.outputs()[of]) - error,
        answer.fields.output_bound.least_of(answer.fields.functionals, of),
    )
    return error / size if size > 0 else math.inf


def relative_errors(many: Any, of: str | None, known: Estimates | None = None) -> np.ndarray | None:
    """The selected error of many answers, (n,), NaN for those without an estimate.

    None if no answer has one.

    Args:
        many: see :class:`~hhr_dolfinx.models.answer.SeveralAnswers`.
        of: see :func:`check_asked`.
        known: ``many.estimates()``, if it is already computed.
    """
    if of is not None and of not in RELATIVE_ERRORS:
        singles = [(answer, answer.estimate()) for answer in many]
        return np.array(
            [
                math.nan if estimate is None else relative_error(answer, estimate, of)
                for answer, estimate in singles
            ]
        )
    estimates = many.estimates() if known is None else known
    if estimates is None:
        return None
    return (
        np.maximum(estimates.primal_relative, estimates.dual_relative)
        if of is None
        else getattr(estimates, RELATIVE_ERRORS[of])
    )
