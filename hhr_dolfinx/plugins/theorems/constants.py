"""Constants and hypotheses of the thesis' theorems, see
:mod:`hhr_dolfinx.plugins.theorems.theorems`.

Each proof uses the form a on different spaces; the constants on these are the sharpest with which
it holds. They are eigenvalues of pencils of the size of the basis, except those on V^0, which have
the size of the RID.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from hhr_dolfinx.certify.constants import Constants
from hhr_dolfinx.errors import BoundError, ReductionError
from hhr_dolfinx.models.eliminations.projected import ReducedProblem
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.plugins.exact_errors.offline import check_hypotheses
from hhr_dolfinx.plugins.theorems.ellipticity import Ellipticity
from hhr_dolfinx.plugins.theorems.rid_norms import Directions, Norms

SLACK = 1e-8
"""Relative accuracy of constants, by which others may be beyond them."""
CONSTANT_NAMES = {"3": "beta_HR of (2.38)", "6": "alpha' of (2.46)"}
"""Names of the constants that are not alpha, (2.9), on the space of the proof."""
OVER_ALL = (
    "its infimum is over all of the reduced space, (2.142), and that of the proof over fewer "
    "functions"
)


@dataclass(frozen=True)
class Spaces:
    """Spaces of the proofs."""

    test: Directions  #: V^0_HR, modes cut off outside A, (2.29)
    test_kernel: Directions  #: those that contact forces do not feel, K^0_HR, (2.35)
    #: whole modes that leave all gaps of the RID as they are, K_HR, (2.45)
    trial_kernel: Directions

    @classmethod
    def of(cls, norms: Norms, reduced: ReducedProblem, basis: np.ndarray) -> Spaces:
        """Spaces of a basis in the norms of its RID.

        Args:
            norms: norms of the RID.
            reduced: the projected problem.
            basis: V, (N, ell).
        """
        cut = basis[norms.domain.sets.A]
        return cls(
            Directions.spanned(cut, norms.inside),
            Directions.spanned(cut @ linalg.null_space(reduced.contact_test), norms.inside),
            Directions.spanned(basis @ linalg.null_space(reduced.contact_trial), norms.whole),
        )


def sharp_constants(norms: Norms, spaces: Spaces, inf_sup: Constants) -> dict[str, Ellipticity]:
    """M_a, and alpha or the constant that replaces it, by theorem.

    Undefined constants are left out.

    Args:
        norms: norms of the RID.
        spaces: spaces of the basis.
        inf_sup: constants of the projection.
    """
    constants = {"4": norms.inner, "8": replace(norms.inner, continuity=norms.from_interface)}
    if inf_sup.beta_HR > 0:  # and not NaN
        constants["3"] = Ellipticity(norms.continuity(spaces.test), inf_sup.beta_HR)
    kernel = spaces.test_kernel
    if kernel.vectors.shape[1] == 0:
        return constants
    continuity = norms.continuity(kernel)
    energies = linalg.eigvalsh(kernel.vectors.T @ (norms.domain.inner @ kernel.vectors))
    constants["4 kernel"] = constants["5"] = Ellipticity(continuity, float(energies[0]))
    if inf_sup.alpha_prime is not None and inf_sup.alpha_prime > 0:
        constants["6"] = Ellipticity(continuity, inf_sup.alpha_prime)
    return constants


def refused(norms: Norms, sharp: dict[str, Ellipticity]) -> dict[str, str]:
    """The hypothesis that fails, by theorem.

    Args:
        norms: norms of the RID.
        sharp: constants of the theorems, see :func:`sharp_constants`.
    """
    no_kernel = "no mode leaves all gaps as they are: alpha on the kernel, (2.39), is not defined"
    reasons = {
        "3": "beta_HR of (2.38) is not positive: some contact force of the RID moves no mode",
        "4 kernel": no_kernel,
        "5": no_kernel,
        "6": "alpha' of (2.46) is not positive, or no mode leaves all gaps as they are",
    }
    failures = {name: reason for name, reason in reasons.items() if name not in sharp}
    reached = int((norms.domain.contact[:, norms.domain.sets.I].getnnz(axis=1) > 0).sum())
    if reached:
        failures["8"] = (
            f"(H2), (2.101), fails: {reached} contact conditions of the RID act on its interface"
        )
    return failures


def given_constants(
    sharp: dict[str, Ellipticity], given: Ellipticity, sigma_min: float | None
) -> dict[str, Ellipticity]:
    """Constants with given M_a and alpha, by theorem.

    Args:
        sharp: constants of the theorems, see :func:`sharp_constants`.
        given: M_a and alpha.
        sigma_min: constant of theorem 3 as printed; None for the sharp one.

    Raises:
        BoundError: if the given constants are not positive.
    """
    if not (0 < given.continuity < math.inf and 0 < given.coercivity < math.inf):
        raise BoundError(
            f"M_a = {given.continuity!r} and alpha = {given.coercivity!r} must be positive numbers"
        )
    # theorems 3 and 6 keep their own constant instead of alpha
    used = {
        name: replace(constants, continuity=given.continuity) if name in CONSTANT_NAMES else given
        for name, constants in sharp.items()
    }
    if sigma_min is None:
        return used
    if "3" in used:
        used["3"] = replace(used["3"], coercivity=sigma_min)
    return used | {name: given for name in ("4 kernel", "5", "6")}


def beyond(used: dict[str, Ellipticity], sharp: dict[str, Ellipticity]) -> dict[str, str]:
    """Theorems for which given constants do not belong to the spaces of the proofs.

    Args:
        used: constants by theorem, see :func:`given_constants`.
        sharp: sharp constants by theorem.

    Returns:
        The reasons, by theorem.
    """
    reasons = {}
    for name in used.keys() & sharp.keys():
        claimed = used[name]
        reference = sharp[name]
        if claimed.continuity < reference.continuity * (1 - SLACK):
            reasons[name] = (
                f"M_a = {claimed.continuity:.3g} is no constant of (2.7), which are "
                f"{reference.continuity:.3g} and more"
            )
        elif claimed.coercivity > reference.coercivity * (1 + SLACK):
            constant_name = CONSTANT_NAMES.get(name, "alpha of (2.9)")
            reasons[name] = (
                f"{claimed.coercivity:.3g} is no {constant_name}, which are "
                f"{reference.coercivity:.3g} and less"
            )
    return reasons


def check_models(full: FullModel, model: ReducedModel) -> None:
    """Refuse models that the theorems are not on.

    Args:
        full: the full model.
        model: the reduced model.

    Raises:
        BoundError: with the hypothesis that fails.
        ReductionError: for a model without a record of its construction, or of another full model.
    """
    problem = full.problem
    if full.equilibrium is not None:
        raise BoundError("bodies flow, and the theorems are on elastic ones")
    if problem.varies:
        raise BoundError(
            "the stiffness depends on parameters, and the constants of the theorems are those of "
            "one"
        )
    if getattr(model, "offline", None) is None:
        raise ReductionError(
            f"{model!r} does not know its basis and its RID: give a reduced model as it was built"
        )
    if model.offline.basis.shape[0] != problem.free.size:
        raise ReductionError(
            f"the reduced model has {model.offline.basis.shape[0]} dofs, the full one "
            f"{problem.free.size}: give both of one scene"
        )
    check_hypotheses(full, floating=True)
    coercivity = Ellipticity.of(full).coercivity
    if not (coercivity > 0 and math.isfinite(coercivity)):
        raise BoundError(f"K is not positive definite, (2.9): alpha = {coercivity:.2g}")
