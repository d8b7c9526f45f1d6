"""Whether a reduced model may be used: stability constants, and errors on solutions it was not trained on.

Perfect inf-sup constants are necessary and not sufficient; cond(K~) and held-out solutions tell more.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import HHRError, NotSolvableError, StabilityWarning, UnstableModelError
from hhr_dolfinx.online.reduced import ReducedModel
from hhr_dolfinx.reduction.rid import IndexSets
from hhr_dolfinx.reduction.stability import Stability
from hhr_dolfinx.snapshots.accuracy import force_floor, relative_error
from hhr_dolfinx.snapshots.solutions import SnapshotSet
from hhr_dolfinx.timing import StageLog


@dataclass(frozen=True)
class TrustLimits:
    """When a model is refused or warned of; the values come from trials on the scenes of the thesis.

    Attributes:
        refuse_cond_K: cond(K~) above which errors grew beyond use.
        warn_cond_K: cond(K~) below which every model was clean.
        warn_kappa_B: kappa(B~) above which dual errors grow, thesis section 3.5.2.
        warn_definite: contact_definite below which two answers to one parameter were seen: at -0.09 by 4 of 100
            parameters, at -0.077 and above by none of 200.
        refuse_inf_sup: smallest inf-sup constant relative to its matrix; below, it is round-off.
        refuse_primal: relative displacement error (L2) on held-out solutions, 95th percentile.
        refuse_dual: relative error of the forces in the RID, floored, 95th percentile.
        warn_primal, warn_dual: likewise, where a warning is due.
    """

    refuse_cond_K: float = 1e7
    warn_cond_K: float = 1e6
    warn_kappa_B: float = 10.0
    warn_definite: float = -0.08
    refuse_inf_sup: float = 1e-10
    refuse_primal: float = 0.2
    refuse_dual: float = 0.6
    warn_primal: float = 0.02
    warn_dual: float = 0.1


@dataclass(frozen=True)
class Validation:
    """Errors of a model on solutions kept out of its training.

    Attributes:
        primal: relative L2 errors of the displacement, one per point.
        dual: relative floored errors of the forces in the RID, one per point.
    """

    primal: np.ndarray
    dual: np.ndarray


def first_trusted(attempt: Callable[[int], Any], layers: int, most_layers: int, log: StageLog):
    """The first attempt that passes its checks; each that does not gets one more layer of cells around its RID.

    Args:
        attempt: builds and checks a model with a number of layers.
        layers: to begin with.
        most_layers: where to give up.
        log: told of every refusal.

    Raises:
        NotSolvableError, UnstableModelError: of the last attempt.
    """
    before = len(log.skipped)
    while True:
        try:
            return attempt(layers)
        except (NotSolvableError, UnstableModelError) as refused:
            log.refused.append({"layers": layers, "why": str(refused)})
            if layers >= most_layers:
                raise
        del log.skipped[before:]
        layers += 1


def check_stability(stability: Stability, limits: TrustLimits) -> None:
    """Refuse or warn of a model whose constants say that it cannot be trusted.

    Raises:
        NotSolvableError: if the rows of B~1 or B~2 are dependent, thesis (1.67), (5.24)-(5.25).
        UnstableModelError: if cond(K~) or an inf-sup constant is beyond its limit.

    Warns:
        StabilityWarning: if cond(K~) or kappa(B~) is in the doubtful range.
    """
    if math.isinf(stability.kappa_B) or math.isinf(stability.kappa_B_2):
        raise NotSolvableError(
            "the contact rows are dependent on the reduced basis, thesis (1.67): keep more modes "
            "(a smaller POD tolerance) or fewer contact points in the RID (fewer layers or zones)"
        )
    advice = "add RID layers, or keep fewer modes (a larger POD tolerance)"
    if not stability.cond_K <= limits.refuse_cond_K:
        raise UnstableModelError(f"cond(K~) = {stability.cond_K:.1e} > {limits.refuse_cond_K:.0e}: {advice}")
    constants = stability.euclidean
    for name, value, size in (
        ("beta_HR", constants.beta_HR, stability.sigma_max),
        ("beta_HR_2", constants.beta_HR_2, stability.sigma_max),
        ("alpha_prime", constants.alpha_prime, stability.norm_K),
    ):
        if value is not None and not value > limits.refuse_inf_sup * size:
            raise UnstableModelError(f"{name} = {value:.1e} is round-off beside {size:.1e}: {advice}")
    if stability.cond_K > limits.warn_cond_K:
        _warn(f"cond(K~) = {stability.cond_K:.1e} > {limits.warn_cond_K:.0e}: {advice}")
    if stability.contact_definite < limits.warn_definite:
        _warn(
            f"contact_definite = {stability.contact_definite:.2g} < {limits.warn_definite:g}: a parameter may have two "
            f"answers or none; {advice}"
        )
    if stability.kappa_B > limits.warn_kappa_B:
        _warn(
            f"kappa(B~) = {stability.kappa_B:.1e} > {limits.warn_kappa_B:g}: contact forces will be inaccurate; "
            "keep more modes, or a smaller kappa_max"
        )


def validate(
    problem: ContactProblem, model: ReducedModel, basis: np.ndarray, sets: IndexSets, held_out: SnapshotSet
) -> Validation:
    """Errors on solutions that were not used for training.

    A point that fails has an infinite error, and so has the force where two starts lead to two answers.
    """
    inside = held_out.forces[sets.A_lambda]
    floor = force_floor(problem, held_out)
    lifts = problem.amplitudes.sum_columns(problem.lifts, held_out.points)
    primal, dual = [], []
    for point, field, lift, forces in zip(held_out.points, held_out.displacements.T, lifts.T, inside.T, strict=True):
        try:
            solution, unaided = model.solve(point), model.solve(point, warm=False)
        except HHRError:
            primal.append(math.inf)
            dual.append(math.inf)
            continue
        primal.append(relative_error(basis @ solution.primal + lift, field + lift, problem.mass))
        differ = relative_error(unaided.forces, solution.forces, floor=floor) > 1e-6
        dual.append(math.inf if differ else relative_error(solution.forces, forces, floor=floor))
    return Validation(np.array(primal), np.array(dual))


def check_validation(validation: Validation, limits: TrustLimits) -> None:
    """Refuse or warn of a model by its errors on held-out solutions.

    Raises:
        UnstableModelError: if the 95th percentile of an error is beyond its limit.

    Warns:
        StabilityWarning: if it is in the doubtful range.
    """
    for name, values, refuse, warn in (
        ("displacement", validation.primal, limits.refuse_primal, limits.warn_primal),
        ("contact force", validation.dual, limits.refuse_dual, limits.warn_dual),
    ):
        # an order statistic, so that failed points do not turn it into NaN
        high = float(np.percentile(values, 95, method="higher"))
        advice = "add RID layers, train on more points, or change the POD tolerance"
        for limit, say in ((refuse, _refuse), (warn, _warn)):
            if high > limit:
                reached = "a point without one answer" if math.isinf(high) else f"{high:.0%} > {limit:.0%}"
                say(f"the {name} error on solutions kept out of training reaches {reached}: {advice}")


def _refuse(message):
    raise UnstableModelError(message)


def _warn(message):
    warnings.warn(message, StabilityWarning, stacklevel=4)
