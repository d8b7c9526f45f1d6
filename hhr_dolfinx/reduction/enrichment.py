"""Enrichment of the primal basis by finite element functions of the contact nodes, thesis section 3.4.1, Alg. 3.1.

A candidate is the normal displacement of the slave node of one contact condition of the RID: its partner
on the other body would change B~ by the same column. Basis and candidates are orthonormalised first, since
kappa(B~) depends on the length of the columns while the reduced model depends on their span only.

Where B~1 != B~2 (section 5.2.5) both must have full rank, (5.24)-(5.25), and kappa(B~1), the one in the error bound
of the forces, is lowered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from hhr_dolfinx.certify.constants import row_range
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.timing import StageLog


@dataclass(frozen=True)
class Enrichment:
    """An enriched basis and the way to it.

    Attributes:
        basis: V bar of (3.2), orthonormal columns, (N, ell_bar).
        added: conditions whose slave node was added, in order, L_c of Alg. 3.1.
        kappas: kappa(B~1) before the first and after each addition; infinite while rows of B~1 or B~2 are dependent.
        stalled: candidates were left, but none lowered kappa any more, before ``kappa_max`` was reached.
    """

    basis: np.ndarray
    added: np.ndarray
    kappas: list[float]
    stalled: bool


def enrich(problem: ContactProblem, basis: np.ndarray, sets: IndexSets, kappa_max: float) -> Enrichment:
    """Add finite element functions until kappa(B~1) <= ``kappa_max``, greedily, Alg. 3.1 and section 5.2.5.

    While rows are dependent no column lowers kappa; then the candidate that lies farthest from the
    range of B~ is taken, which raises the rank. The singular values of a candidate come from a rank-one
    update of B~ B~^T, without its basis being formed.
    """
    candidates = _candidates(problem, sets)  # they vanish outside A_c
    rows = problem.contact[sets.A_lambda]
    images = rows[:, sets.A_c] @ candidates
    # B~1 and B~2; a candidate has the same image in both
    tables = [rows[:, index] @ basis[index] for index in (sets.A_c, sets.A_c_tilde)]
    inner, weights = candidates.T @ candidates, basis[sets.A_c].T @ candidates
    left = np.flatnonzero(np.diag(inner) > 0)
    added, kappas, stalled = [], [_kappa_of_both(problem, tables)], False
    while kappas[-1] > kappa_max:
        # length of each candidate less its part in the basis
        lengths = np.sqrt(np.maximum(np.diag(inner)[left] - np.sum(weights[:, left] ** 2, axis=0), 0.0))
        left, lengths = left[lengths > 1e-8], lengths[lengths > 1e-8]
        if left.size == 0:
            break
        new = [(images[:, left] - table @ weights[:, left]) / lengths for table in tables]
        best = _best(problem, tables, new)
        grown = [np.column_stack([table, columns[:, best]]) for table, columns in zip(tables, new, strict=True)]
        kappa = _kappa_of_both(problem, grown)
        if kappa >= kappas[-1] and math.isfinite(kappas[-1]):
            stalled = True
            break
        chosen = left[best]
        left = np.delete(left, best)
        tables = grown
        weights = np.vstack([weights, (inner[chosen] - weights[:, chosen] @ weights) / lengths[best]])
        added.append(chosen)
        kappas.append(kappa)
    functions = np.zeros((basis.shape[0], len(added)))
    functions[sets.A_c] = candidates[:, added]
    enriched, _ = linalg.qr(np.hstack([basis, functions]), mode="economic")
    return Enrichment(enriched if added else basis, sets.A_lambda[np.array(added, dtype=int)], kappas, stalled)


def record_enrichment(enrichment: Enrichment, kappa_max: float, log: StageLog) -> None:
    """Tell the log that there was none, or why it stopped early."""
    kappa = enrichment.kappas[-1]
    if kappa > kappa_max:
        why = "no function lowers it further" if enrichment.stalled else "no function is left"
        log.skip("further_enrichment", f"kappa(B~) = {kappa:.2f} > {kappa_max:g}, but {why}")
    elif not len(enrichment.added):
        log.skip("enrichment", f"kappa(B~) = {kappa:.2f} <= {kappa_max:g} and (1.67) holds")


def _candidates(problem, sets):
    """Unit normal displacement of the slave node of each condition, or of its partners if that is imposed.

    Columns over A_c, (card A_c, N_lambda_C); zero where neither can move inside A.
    """
    rows = problem.contact[sets.A_lambda][:, sets.A_c].toarray()
    own = sets.A_c // problem.block_size == problem.contact_slaves[sets.A_lambda][:, None]
    chosen = np.where(np.any(rows * own, axis=1)[:, None], rows * own, rows)
    lengths = np.linalg.norm(chosen, axis=1, keepdims=True)
    return (chosen / np.where(lengths > 0, lengths, 1.0)).T


def _kappa_of_both(problem, tables):
    """kappa(B~1); infinite unless both B~1 and B~2 have full rank."""
    first, second = (problem.condition_number(*row_range(table)) for table in tables)
    return first if math.isfinite(second) else math.inf


def _best(problem, tables, new) -> int:
    """Index of the best new column: it raises a rank that is missing, or else lowers kappa(B~1) most."""
    for table, columns in zip(tables, new, strict=True):
        directions, values = _svd(table, full=True)
        rank = sum(math.isfinite(problem.condition_number(value, values[0])) for value in values)
        if rank < table.shape[0]:
            return int(np.linalg.norm(directions[:, rank:].T @ columns, axis=0).argmax())
    directions, values = _svd(tables[0], full=False)
    smallest, largest = _extremes_after_update(values**2, (directions.T @ new[0]) ** 2)
    # the squares lose half of the digits: good enough to choose, not to report
    return int(np.argmax(smallest / largest))


def _svd(table: np.ndarray, *, full: bool) -> tuple[np.ndarray, np.ndarray]:
    """Left singular vectors and singular values, largest first."""
    try:
        return linalg.svd(table, full_matrices=full)[:2]
    except linalg.LinAlgError:  # divide and conquer, the fast way, ends so for a few matrices of full precision
        return linalg.svd(table, full_matrices=full, lapack_driver="gesvd")[:2]


def _extremes_after_update(squares, weights):
    """Smallest and largest eigenvalue of diag(squares) + z z^T for each column z^2 of ``weights``.

    They are roots of the secular equation 1 + sum_i z_i^2 / (d_i - x) = 0: the smallest lies between the two
    smallest d_i, the largest between the largest one and that plus |z|^2. Bisection for all columns at once.
    """

    def root(low, high):
        for _ in range(60):
            middle = 0.5 * (low + high)
            with np.errstate(divide="ignore", invalid="ignore"):
                above = 1 + np.sum(weights / (squares[:, None] - middle), axis=0) > 0
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        return high

    total = weights.sum(axis=0)
    ones = np.ones(weights.shape[1])
    last = squares[-2] if squares.size > 1 else squares[-1] + total
    return root(squares[-1] * ones, last * ones), root(squares[0] * ones, squares[0] + total)
