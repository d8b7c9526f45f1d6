"""Trust check of a reduced model: stability constants, and errors on validation solutions.

Perfect inf-sup constants are necessary and not sufficient; cond(K~) and validation solutions are
more reliable.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from numbers import Real
from typing import Self

import numpy as np
from scipy.sparse import csr_matrix, diags, triu
from scipy.spatial import cKDTree

from hhr_dolfinx.certify.accuracy import Solutions
from hhr_dolfinx.certify.compare import Comparison
from hhr_dolfinx.certify.constants import Stability
from hhr_dolfinx.contact.problem import DEPENDENT_ROWS, ContactProblem, IndexSets
from hhr_dolfinx.errors import (
    NotSolvableError,
    ReductionError,
    StabilityWarning,
    TrainingWarning,
    UncheckedWarning,
    UnseenLoadError,
    UnstableModelError,
)
from hhr_dolfinx.pairings.surface import normalised
from hhr_dolfinx.warn import warn

EMPTY = 1.5
"""Distance from the training, over that between training points, above which a region counts as
empty.
"""
EMPTY_SHARE = 0.1
"""Part of the box that may be empty; random points leave some per cent."""
EQUAL_NORMALS = 1e-10
"""One less the cosine of two normals of a node up to which they are equal."""
UNSEEN = 0.5
UNSEEN_LEAST = 0.05
"""Logarithmic distance of a modulus from those in training that is allowed: part of their range,
and at least.
"""
FEW = 20
"""Number of validation solutions below which a region of a twentieth of the box is likely
missed.
"""


@dataclass(frozen=True)
class TrustLimits:
    """Limits above which a model is refused or warned of.

    The values come from trials on the scenes of the thesis.

    Attributes:
        refuse_cond_K: cond(K~) above which errors became too large, if the RID is the cause.
        refuse_distortion: cond(K~) over that of V^T K V; below, the stiffness itself is
            ill-conditioned (bodies a million times as stiff as others, flat cells), which does not
            affect answers.
        warn_cond_K: cond(K~) below which every model was accurate.
        warn_kappa_B: kappa(B~) above which dual errors grow, thesis section 3.5.2.
        warn_definite: contact_definite below which a parameter had two solutions, or none.
        refuse_inf_sup: smallest inf-sup constant relative to its matrix; below, it is round-off.
        refuse_primal: error of the displacement everywhere on solutions that were compared, 95th
            percentile.
        refuse_dual: error of the forces on the whole contact surface, with a floor, 95th
            percentile.
        warn_primal, warn_dual: 95th percentile above which a warning is given.
        warn_worst: largest force error above which a warning is given.
    """

    refuse_cond_K: float = 1e7
    refuse_distortion: float = 1e3
    warn_cond_K: float = 1e6
    warn_kappa_B: float = 10.0
    warn_definite: float = -0.08
    refuse_inf_sup: float = 1e-10
    refuse_primal: float = 0.2
    refuse_dual: float = 0.6
    warn_primal: float = 0.02
    warn_dual: float = 0.05
    warn_worst: float = 0.1

    def __post_init__(self) -> None:
        """Raise ReductionError for invalid limits, and for warnings above the limit of refusal."""
        for attribute in fields(self):
            value: float = getattr(self, attribute.name)
            signed = attribute.name == "warn_definite"
            least = -math.inf if signed else 0.0
            if not isinstance(value, Real) or isinstance(value, bool) or not float(value) >= least:
                raise ReductionError(
                    f"{attribute.name} = {value!r} of TrustLimits must be a "
                    f"number{'' if signed else ', not negative'}: math.inf for no limit"
                )
        limits = {attribute.name: getattr(self, attribute.name) for attribute in fields(self)}
        for name, refuse in limits.items():
            warned = name.replace("refuse_", "warn_")
            if refuse < limits.get(warned, 0.0) < math.inf:
                raise ReductionError(
                    f"{warned} = {limits[warned]:g} of TrustLimits lies beyond {name} = "
                    f"{refuse:g}: a model would be refused before it is warned of. Give a smaller "
                    f"{warned} too, or math.inf for no warning"
                )

    def judged(
        self, comparison: Comparison
    ) -> Iterator[tuple[str, np.ndarray, float, float, float]]:
        """Names and values of errors with their limits.

        Returns:
            Name, values, limits of the 95th percentile (refused, warned of) and limit of the worst
            value of each error.
        """
        yield "displacement", comparison.primal, self.refuse_primal, self.warn_primal, math.inf
        yield "contact force", comparison.dual, self.refuse_dual, self.warn_dual, self.warn_worst

    @classmethod
    def of_histories(cls, **changes: float) -> Self:
        """Limits for load paths, whose forces vary more from node to node.

        Measured 0.2 and 4 % in good models.
        """
        return cls(**{"warn_primal": 0.03, "warn_dual": 0.1, "warn_worst": 0.1} | changes)


def check_loads_seen(problem: ContactProblem, sets: IndexSets, points: np.ndarray) -> None:
    """Check that each load of the training reaches the RID.

    Args:
        problem: the contact problem.
        sets: index sets of the RID.
        points: training points, (S, P).

    Raises:
        UnseenLoadError: if a load that is nonzero at a training point does not reach the RID.
    """
    acting = np.zeros(problem.loads.shape[1], dtype=bool)
    for point in points:
        theta = problem.amplitudes(point)
        acting[theta.terms] |= np.asarray(theta.values) != 0
    for term in np.flatnonzero(acting):
        column = problem.loads[:, [term]].toarray()
        if np.any(column) and not np.any(column[sets.A]):
            raise UnseenLoadError(
                f"load term {term} of the scene does not reach the RID: add nodes next to where "
                "it acts to the zone"
            )


MORE_LAYERS = "add RID layers (in Python, hhr.Recipe(domain=hhr.Rid(layers=4)))"
"""Python code that enlarges a RID: no command has an option for it."""


def check_solvable(
    stability: Stability, problem: ContactProblem | None = None, sets: IndexSets | None = None
) -> None:
    """Check that the rows of B~1 and of B~2 are independent, thesis (1.67), (5.24)-(5.25).

    The message names equivalent conditions if the problem and the RID are given.

    Args:
        stability: constants of the reduced model.
        problem: the contact problem, for the message; None if unknown.
        sets: index sets of the RID, for the message; None if unknown.

    Raises:
        NotSolvableError: if rows are dependent.
    """
    if not (math.isinf(stability.kappa_B) or math.isinf(stability.kappa_B_2)):
        return
    twins = ""
    if problem is not None and sets is not None:
        if same := _parallel_rows(problem.contact[sets.A_lambda]):
            raise NotSolvableError(
                f"{same} contact conditions say the same as another one, as a stop does beside a "
                "pair whose master is imposed: no basis tells their forces apart, thesis (1.67). "
                "Leave one of the two contacts out, or end their surfaces at different nodes"
            )
        twins = _twins(problem, sets)
    raise NotSolvableError(
        "the contact rows are dependent on the reduced basis, thesis (1.67): "
        + (
            twins
            or "keep more modes (a smaller POD tolerance) or fewer contact points in the RID "
            "(layers, zones)"
        )
    )


def _twins(problem: ContactProblem, sets: IndexSets) -> str:
    """Message on conditions of the RID that hold one node along one normal.

    Only modes of the other side separate them.

    Empty without any.
    """
    normals = np.zeros((len(sets.A_lambda), problem.block_size))
    for row, number in zip(normals, sets.A_lambda, strict=True):
        dofs = problem.contact_slaves[number] * problem.block_size + np.arange(problem.block_size)
        row[:] = problem.contact[number][:, dofs].toarray()[0]
    directions = normalised(normals)
    nodes = problem.contact_slaves[sets.A_lambda]
    alike = (nodes[:, None] == nodes) & (directions @ directions.T > 1 - EQUAL_NORMALS)
    first, second = (sets.A_lambda[ends] for ends in np.nonzero(np.triu(alike, k=1)))
    if not first.size:
        return ""
    pairs = problem.contact_pairs[[first[0], second[0]]]
    coordinates = np.round(problem.contact_points[first[0]], 6).tolist()
    return (
        f"contacts {pairs[0]} and {pairs[1]} hold the same node along the same normal, at "
        f"{coordinates} and {first.size} places in all: more modes seldom tell their forces apart. "
        "Leave out the one that never closes, or take a condensed model, which needs no modes "
        "(Training.condense; exact_condensation where the stiffness is constant)"
    )


def _parallel_rows(contact: csr_matrix) -> int:
    """Number of rows that are a positive multiple of a later row, to round-off."""
    lengths = np.sqrt(np.asarray(contact.multiply(contact).sum(axis=1)).ravel())
    units = csr_matrix(diags(1 / np.where(lengths > 0, lengths, 1.0)) @ contact)
    alike = triu(units @ units.T, k=1).tocoo()
    return len(set(alike.row[alike.data > 1 - DEPENDENT_ROWS].tolist()))


def check_stability(stability: Stability, limits: TrustLimits) -> None:
    """Check the stability constants of a model against limits.

    Args:
        stability: constants of the model.
        limits: limits of refusals and warnings.

    Raises:
        UnstableModelError: if a constant is beyond its limit.

    Warns:
        StabilityWarning: if a constant is close to its limit.
    """
    advice = f"{MORE_LAYERS}, or keep fewer modes (a larger POD tolerance)"
    distorted = not stability.distortion <= limits.refuse_distortion
    if distorted and not stability.cond_K <= limits.refuse_cond_K:
        raise UnstableModelError(
            f"cond(K~) = {stability.cond_K:.1e} > {limits.refuse_cond_K:.0e}: {advice}"
        )
    constants = stability.euclidean
    for name, value, size in (
        ("beta_HR", constants.beta_HR, stability.sigma_max),
        ("beta_HR_2", constants.beta_HR_2, stability.sigma_max),
        ("alpha_prime", constants.alpha_prime, stability.norm_K),
    ):
        if value is not None and not value > limits.refuse_inf_sup * size:
            raise UnstableModelError(
                f"{name} = {value:.1e} is round-off beside {size:.1e}: {advice}"
            )
    if distorted and stability.cond_K > limits.warn_cond_K:
        _warn(f"cond(K~) = {stability.cond_K:.1e} > {limits.warn_cond_K:.0e}: {advice}")
    if stability.contact_definite < limits.warn_definite:
        _warn(
            f"contact_definite = {stability.contact_definite:.2g} < {limits.warn_definite:g}: a "
            f"parameter may have two answers or none; {advice}"
        )
    if stability.kappa_B > limits.warn_kappa_B:
        _warn(
            f"kappa(B~) = {stability.kappa_B:.1e} > {limits.warn_kappa_B:g}: contact forces will "
            "be inaccurate; keep more modes, or a smaller kappa_max"
        )


OF_A_RID = f"{MORE_LAYERS}, train on more points, or change the POD tolerance"


def check_comparison(
    comparison: Comparison, limits: TrustLimits, remedy: str | Mapping[str, str] = OF_A_RID
) -> None:
    """Check the errors of a model against limits.

    The worst point is named; a warning is given if its force error is beyond a separate limit.

    Args:
        comparison: errors against the full order.
        limits: limits of refusals and warnings.
        remedy: advice for the kind of model, or advice by the name of the error.

    Raises:
        UnstableModelError: if the 95th percentile of an error is beyond its limit.

    Warns:
        StabilityWarning: if it is close to its limit.
    """
    for name, values, refuse, doubtful, doubtful_worst in limits.judged(comparison):
        # an order statistic: failed points do not make it NaN
        high = float(np.percentile(values, 95, method="higher"))
        worst = int(values.argmax())
        reached = (
            f"it is {values[worst]:.0%}"
            if math.isfinite(values[worst])
            else "there is no one answer"
        )
        message = (
            f"the {name} error, on the whole mesh, is {_share(high)} at 95 % of {values.size} "
            f"solutions compared; the worst is at {comparison.labels[worst]}, where {reached}: "
            + (remedy if isinstance(remedy, str) else remedy[name])
        )
        if not high <= refuse:  # NaN fails too
            raise UnstableModelError(message)
        # a point without an answer is always reported
        if high > doubtful or values[worst] > doubtful_worst or not math.isfinite(values[worst]):
            _warn(message)


def warn_of_no_contact(problem: ContactProblem, snapshots: Solutions) -> None:
    """Warn of a training without contact.

    Args:
        problem: the contact problem.
        snapshots: training answers.
    """
    if not snapshots.any_contact(problem):
        _warn(
            "no training solution has contact: the model knows nothing of contact forces. Check "
            "gaps, normals and loads, or train where bodies touch",
            TrainingWarning,
        )


def warn_of_few_held_out(
    held_out: Solutions | None, least: int = FEW, advice: str = f"at least {FEW}"
) -> None:
    """Warn of no or few validation solutions.

    Args:
        held_out: validation answers; None if there are none.
        least: number of answers below which a warning is given.
        advice: advice for the message.
    """
    if held_out is None:
        warning = (
            "no solutions were kept out of training: the model is compared with its own training "
            "only, and its error elsewhere is unknown"
        )
    elif len(held_out.points) >= least:
        return
    else:
        warning = (
            f"only {len(held_out.points)} solutions were kept out of training: errors between "
            "them are hardly known"
        )
    warn(f"{warning}. Give {advice} as held_out, as train does", UncheckedWarning)


def warn_of_gaps_in_training(points: np.ndarray) -> None:
    """Warn of training points, (S, P), that leave much of their box empty, as a diagonal does.

    Distances count in steps between the different values of each parameter. On a grid, and for
    random points, no part of the box is farther from the training than training points are from
    each other.
    """
    counts = np.array([np.unique(column).size for column in points.T])
    widths = np.ptp(points, axis=0)
    varied = widths > 0
    if len(points) < 3 or not varied.any():
        return
    scaled = (
        (points[:, varied] - points[:, varied].min(axis=0)) / widths[varied] * (counts[varied] - 1)
    )
    tree = cKDTree(scaled)
    apart = tree.query(scaled, k=2)[0][:, 1].max()
    anywhere = np.random.default_rng(0).uniform(0.0, counts[varied] - 1, (500, int(varied.sum())))
    empty = float(np.mean(tree.query(anywhere)[0] > EMPTY * apart))
    if empty > EMPTY_SHARE:
        _warn(
            f"the training points leave {empty:.0%} of their box empty: answers there are outside "
            "what was trained, and no check of the box sees it. Train on a grid or on points "
            "drawn at random",
            TrainingWarning,
        )


def warn_of_moduli_unseen(problem: ContactProblem, points: np.ndarray) -> None:
    """Warn of a modulus with values far from those at the training points, (S, P).

    A spike is narrower than the distance of training points, so that validation points miss it.
    Moduli are numbers, and are evaluated densely along each of their parameters, with the others in
    the middle.

    Args:
        problem: the contact problem.
        points: training points, (S, P).
    """
    space = problem.parameters
    scalars = [
        scalar
        for modulus in problem.moduli
        for scalar in (modulus.factor_scalar, modulus.rest_scalar)
    ]
    for scalar in dict.fromkeys(scalars):
        indices = [space.names.index(name) for name in scalar.formula.variables]
        samples = space.lines(indices, 1)
        with np.errstate(divide="ignore"):
            seen, sampled = (np.log(np.abs(scalar.values(where))) for where in (points, samples))
        if not (indices and np.isfinite(seen).all() and np.isfinite(sampled).all()):
            continue
        beyond = np.maximum(sampled - seen.max(), seen.min() - sampled)
        worst = int(beyond.argmax())
        if beyond[worst] > max(UNSEEN * np.ptp(seen), UNSEEN_LEAST):
            _warn(
                f"the modulus {scalar.text[:80]} is {scalar.value(samples[worst]):.3g} at "
                f"{space.described(samples[worst])}, and {np.exp(seen.min()):.3g} to "
                f"{np.exp(seen.max()):.3g} at all training points: it changes faster than they "
                "are close, and answers there are outside what was trained. Train there too, or "
                "smooth the formula",
                TrainingWarning,
            )


def _share(value: float) -> str:
    return "infinite" if math.isinf(value) else f"{value:.1%}"


def _warn(message: str, category: type[Warning] = StabilityWarning) -> None:
    warn(message, category)
