"""Which errors the answers of a model know, in one line; and the one that a user asks for, as a number.

One place for all kinds of models: all is read off what completes their answers.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from hhr_dolfinx.errors import NoBoundWarning, ParameterError
from hhr_dolfinx.models.answer import ModelFields
from hhr_dolfinx.models.estimates import SHOWN, Estimate

HOW = {
    "bound": "bound, proved",
    "estimate": "estimate, since the interpolation between parameters is observed and not proved",
}
"""Kinds of what is known, in words."""
NOT_ASKED = "the recipe asks for none"
"""Why there is no bound of what was built without one."""
NORMS = "the displacement in energy; nodal contact forces, Euclidean and in energy; pressures"
ASKED = ("forces", "pressure", "displacement")
"""Errors by which a model may fall back, beside those of outputs."""


def known_error(fields: ModelFields) -> str:
    """Which errors answers know that are completed by some fields, or why they know none.

    Args:
        fields: see :class:`~hhr_dolfinx.models.answer.Fields`.
    """
    kind = fields.estimated
    if fields.bound is not None:
        known, others = _outputs(fields)
        outputs = f"; outputs {', '.join(known)}" if known else ""
        return f"{HOW[kind]}: {NORMS}{outputs}" + (f". None of {', '.join(others)}" if others else "")
    if fields.indicator is not None:
        return "indicator of the recipe: follows errors as far as it is made to, without a proof"
    if fields.flow is not None:
        return "indicator of the stress: the part of it that no training explains; without a proof, silent on forces"
    if fields.exact:
        return f"none is made: {fields.unbounded}"
    return f"none: {fields.unbounded or 'answers of this kind estimate no errors'}"


def _outputs(fields: ModelFields) -> tuple[list[str], list[str]]:
    """Names of the outputs with a bound, and of those without."""
    items, bounds = () if fields.functionals is None else fields.functionals.items, fields.output_bound
    known = [item.name for k, item in enumerate(items) if bounds is not None and bounds.knows(k, item)]
    return known, [item.name for item in items if item.name not in known]


def warn_unbounded(fields: ModelFields) -> None:
    """Warn where answers of a model that was asked for bounds know none: what is wrong there is silent."""
    why = fields.unbounded
    if why and why != NOT_ASKED and fields.bound is None:
        warnings.warn(
            f"nothing is known of the errors of these answers: {why}. They were compared with answers held "
            "out, and may be far off between them: hold out more, or ask the full model where it counts",
            NoBoundWarning,
            stacklevel=4,
        )


def check_asked(fields: ModelFields, of: Any) -> None:
    """Check that an error may be asked for: None, one of :data:`ASKED`, or the name of an output with a bound.

    Raises:
        ParameterError: for another word, or an output without a bound, with the reason.
    """
    known, others = _outputs(fields)
    check_word([*known, *others], of)
    if of in others and of not in ASKED:
        why = "it has no Lipschitz constant: it jumps, or is one of your own that names none"
        if fields.output_bound is None:
            why = "outputs are bounded only where the stiffness does not depend on parameters and all bodies are held"
        raise ParameterError(f"nothing bounds the error of output {of!r}: {why}. Take {', '.join([*ASKED, *known])}")


def check_word(outputs: Sequence[str], of: Any) -> None:
    """Raise ParameterError for what is neither None, nor one of :data:`ASKED`, nor the name of an output."""
    if of is not None and not (isinstance(of, str) and of in (*ASKED, *outputs)):
        raise ParameterError(
            f"of = {of!r} is no error that is known here: give {', '.join(repr(word) for word in (*ASKED, *outputs))}, "
            "or None for displacement and forces in energy"
        )


def relative_error(answer: Any, estimate: Estimate, of: str | None) -> float:
    """What an estimate says of the error asked for, relative to the exact answer.

    Args:
        answer: which is read where an output is asked for.
        estimate: of its error.
        of: see :func:`check_asked`; None takes the larger one of displacement and forces, both in energy.
    """
    if of is None:
        # of a NaN neither is larger
        worst = (estimate.primal_relative, estimate.dual_relative)
        return math.nan if any(map(math.isnan, worst)) else max(worst)
    if of in SHOWN:
        return float(getattr(estimate, SHOWN[of]))
    error = estimate.outputs.get(of, math.inf)
    size = max(abs(answer.outputs()[of]) - error, answer.fields.output_bound.least_of(answer.fields.functionals, of))
    if error == 0:
        return 0.0
    return error / size if size > 0 else math.inf


def relative_errors(many: Any, of: str | None) -> np.ndarray | None:
    """The same of many answers, (n,), NaN where nothing is known; None where nothing is of any.

    Args:
        many: see :class:`~hhr_dolfinx.models.answer.SeveralAnswers`.
        of: see :func:`check_asked`.
    """
    if of is not None and of not in SHOWN:
        singles = [(answer, answer.estimate()) for answer in many]
        return np.array([math.nan if known is None else relative_error(answer, known, of) for answer, known in singles])
    found = many.estimates()
    if found is None:
        return None
    return np.maximum(found.primal_relative, found.dual_relative) if of is None else getattr(found, SHOWN[of])
