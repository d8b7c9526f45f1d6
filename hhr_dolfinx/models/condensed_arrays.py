"""Arrays of a compiled step of condensed flow, see :mod:`hhr_dolfinx.models.condensed_step`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

EVALUATE, CONVERGED, STALLED, LIMIT, NOT_FINITE, CONTACT = range(6)
"""What :func:`judge` answers: evaluate the laws at the trial point, or why it stopped."""
ITERATION, MERIT, SHARE, SIZE, COUNT, SWITCHED, LINEAR, NUMBERS = range(8)
"""Places in ``Work.numbers``: laws evaluated, |R| at ``here``, part of the direction tried, largest |g| so far, active
conditions, changes of the inverse; whether J is none, an old one, or of ``here``."""
NO_TANGENT, OLD_TANGENT, NEW_TANGENT = range(3)


class StepModel(NamedTuple):
    """Arrays of a model at its moduli (n points of c components, ell modes, m conditions, G groups of points).

    Strains lie component by component, so that loops over points run side by side.

    Attributes:
        per_mode: strain of each mode, (ell, c n).
        tested: quadrature weight times 2 μ times the deviator of each, (ell, c n), in the moduli for which modes have
            unit energy.
        per_force: strain of K^-1 B^T in these moduli, (m, c n).
        scale: factor of the strain of contact forces, (c n,); nothing where it is 1.
        schur: S, (m, m).
        moved: B V, (m, ell).
        modal: Q, (ell, ell).
        coupled: P, (ell, m).
        ends: last point of each group and one, (G,).
        shear: of each group, (G,).
        weight: norm of ``tested``.
        single: ``per_mode`` in single precision, for Newton's matrix.
    """

    per_mode: np.ndarray
    tested: np.ndarray
    per_force: np.ndarray
    scale: np.ndarray
    schur: np.ndarray
    moved: np.ndarray
    modal: np.ndarray
    coupled: np.ndarray
    ends: np.ndarray
    shear: np.ndarray
    weight: float
    single: np.ndarray


class StepLoad(NamedTuple):
    """What a step is given.

    Attributes:
        strain: strain without correction and contact forces, (c n,).
        forces: λ_e, (m,).
        slack: slack without correction and contact forces, (m,).
        plastic: plastic strain before the step, (c, n).
        cumulated: cumulated plastic strain before it, (n,).
        dt: its length in seconds.
    """

    strain: np.ndarray
    forces: np.ndarray
    slack: np.ndarray
    plastic: np.ndarray
    cumulated: np.ndarray
    dt: float


class Work(NamedTuple):
    """What a step works on; ``here`` is the last accepted correction, ``there`` the one that is tried.

    Attributes:
        here, there, direction, residual, left: corrections, direction, and R at ``there`` and ``here``, (ell,) each.
        forces, slack: of the contact problem at ``there``, (m,) each.
        active: its statuses, (m,) bool.
        order: active conditions as they stand in ``inverse``, (m,).
        inverse: of S_AA in its upper left corner, (m, m).
        rows: E_X,A above, in this order, (m, c n).
        newton: inverse of -J, (ell, ell).
        strain: at ``there``, (c n,).
        deviator: of the trial stress, (c, n).
        trial, amount, slope: equivalent trial stress, flow and its slope, (n,) each.
        plastic: plastic strain at ``there``, (c, n).
        numbers: iterations and the like, see ``ITERATION``.
    """

    here: np.ndarray
    there: np.ndarray
    direction: np.ndarray
    residual: np.ndarray
    left: np.ndarray
    forces: np.ndarray
    slack: np.ndarray
    active: np.ndarray
    order: np.ndarray
    inverse: np.ndarray
    rows: np.ndarray
    newton: np.ndarray
    strain: np.ndarray
    deviator: np.ndarray
    trial: np.ndarray
    amount: np.ndarray
    slope: np.ndarray
    plastic: np.ndarray
    numbers: np.ndarray

    @classmethod
    def of(cls, modes: int, conditions: int, points: int, components: int) -> Work:
        """Arrays of these sizes, with nothing active."""
        ell, m, n, c = modes, conditions, points, components
        # not by shape: two sizes may be the same
        shapes: dict[str, Any] = dict.fromkeys(("here", "there", "direction", "residual", "left"), ell)
        shapes |= dict.fromkeys(("forces", "slack"), m) | dict.fromkeys(("trial", "amount", "slope"), n)
        shapes |= dict.fromkeys(("deviator", "plastic"), (c, n)) | {"newton": (ell, ell)}
        shapes |= {"inverse": (m, m), "rows": (m, c * n), "strain": c * n, "numbers": NUMBERS}
        arrays = {name: np.zeros(shape) for name, shape in shapes.items()}
        return cls(**arrays, active=np.zeros(m, dtype=bool), order=np.zeros(m, dtype=np.int64))
