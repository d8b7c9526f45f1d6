"""Enrichment of the primal basis, thesis section 3.4.1, Alg. 3.1.

The basis gets finite element functions of the contact nodes.

A candidate is the normal displacement of the slave node of one contact condition of the RID: its
partner on the other body would change B~ by the same column. If two conditions share a slave node
and a direction, as a pair and a stop on one surface do, the partner distinguishes them. Basis and
candidates are orthonormalised first, since kappa(B~) depends on the length of the columns while the
reduced model depends on their span only.

If B~1 != B~2 (section 5.2.5) both must have full rank, (5.24)-(5.25), and kappa(B~1), the one in
the error bound of the forces, is lowered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.problem import DEPENDENT_ROWS, ContactProblem, IndexSets
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.linear.dense import GrowingColumns
from hhr_dolfinx.linear.rows import Rows
from hhr_dolfinx.pairings.surface import normalised
from hhr_dolfinx.timing import StageLog

DISTINCT = 1e-8
"""Length of the part of a unit function outside a span below which it counts as inside: the root of
round-off.
"""

LENGTH_LEFT = math.sqrt(0.5)
"""Remaining length of a unit function above which round-off is small enough (Daniel, Gragg, Kaufman
and Stewart, Mathematics of Computation 30, 1976).
"""

MODE_ROUND_OFF = 1e-8
"""Round-off allowed in products of orthogonal modes, and in modes on imposed dofs."""


@dataclass(frozen=True)
class Enrichment:
    """An enriched basis and the steps of its enrichment."""

    basis: np.ndarray  #: V bar of (3.2), orthonormal columns, (own, ell_bar)
    added: np.ndarray  #: conditions whose slave node was added, in order, L_c of Alg. 3.1
    kappas: list[
        float
    ]  #: kappa(B~1) before the first and after each addition; infinite while rows are dependent
    #: candidates were left, but none lowered kappa any more, before ``kappa_max`` was reached
    stalled: bool
    left_out: (
        np.ndarray
    )  #: conditions whose function lies in the span of the basis already, as of a second stop


def enrich(
    problem: ContactProblem, basis: np.ndarray, sets: IndexSets, kappa_max: float
) -> Enrichment:
    """Add finite element functions until kappa(B~1) <= ``kappa_max``, greedily, Alg. 3.1.

    See section 5.2.5 too. While rows are dependent no column lowers kappa; then the candidate that
    lies farthest from the range of B~ is added, which raises the rank. The singular values of a
    candidate come from a rank-one update of B~ B~^T, without forming its basis. That update has the
    length of a candidate outside the basis only to the root of round-off. So the chosen one is
    orthogonalised exactly, and left out if nothing remains of it.

    Args:
        problem: the contact problem.
        basis: orthonormal modes, (own, ell).
        sets: index sets of the RID.
        kappa_max: condition number down to which functions are added; infinite for none.

    Raises:
        ReductionError: if the basis moves imposed dofs, breaks constraints, or is not orthonormal.
    """
    support, candidates = _prolonged(
        problem, sets.A_c, _candidates(problem, sets)
    )  # they vanish outside
    read = np.union1d(sets.A_c_tilde, support)
    contact_rows = problem.contact[sets.A_lambda]
    images = contact_rows[:, support] @ candidates
    columns = GrowingColumns(
        np.zeros((len(basis), 0))
    )  # after those of the basis, which is not copied
    rows = problem.spread
    # B~1 and B~2; a candidate has the same image in both
    tables = [
        _Table.of(problem, contact_rows[:, dofs], basis, dofs, images)
        for dofs in (sets.A_c, sets.A_c_tilde)
    ]
    squares = np.sum(candidates**2, axis=0)
    weights = rows.at(basis, support).T @ candidates
    pool = np.flatnonzero(squares > 0)
    added = []
    left_out = []
    kappas = [rows.first(_kappa(tables))]
    stalled = False
    while kappas[-1] > kappa_max:
        # length of each candidate minus its part in the basis
        lengths = np.sqrt(np.maximum(squares[pool] - np.sum(weights[:, pool] ** 2, axis=0), 0.0))
        left_out.extend(pool[lengths <= DISTINCT])
        pool = pool[lengths > DISTINCT]
        lengths = lengths[lengths > DISTINCT]
        if pool.size == 0:
            break
        best = rows.first(_best(tables, images[:, pool], weights[:, pool], lengths, pool))
        chosen = pool[best]
        pool = np.delete(pool, best)
        function = rows.of(np.bincount(support, candidates[:, chosen], rows.count))
        column = _outside((basis, columns.all), function, weights[:, chosen], rows)
        if column is None:
            left_out.append(chosen)
            continue
        values = rows.at(column, read)
        tables = [
            table.grown(values[np.searchsorted(read, table.part)], chosen) for table in tables
        ]
        kappa = rows.first(_kappa(tables))
        if kappa >= kappas[-1] and math.isfinite(kappas[-1]):
            stalled = True
            break
        columns.append(column)
        weights = np.vstack([weights, values[np.searchsorted(read, support)] @ candidates])
        added.append(chosen)
        kappas.append(kappa)
    basis = np.column_stack([basis, columns.all]) if added else basis
    check_basis(problem, basis)
    conditions = [sets.A_lambda[np.array(chosen, dtype=int)] for chosen in (added, left_out)]
    return Enrichment(basis, conditions[0], kappas, stalled, conditions[1])


def check_basis(
    problem: ContactProblem, basis: np.ndarray, whose: str = "the enriched basis"
) -> None:
    """Check a basis: imposed dofs, constraints, orthonormal columns.

    With dofs that follow others V must be T V: the equations, the residual of laws and the
    displacement of an answer read different dofs of it.

    Args:
        problem: the contact problem.
        basis: local rows of the basis, (own, ell).
        whose: name of the basis, for the message.

    Raises:
        ReductionError: if it moves imposed dofs, breaks constraints, or is not orthonormal.
    """
    rows = problem.spread
    imposed = rows.largest(
        np.abs(basis).max(axis=1, initial=0.0) * ~rows.of(problem.prolongation.movable)
    )[1]
    if imposed > MODE_ROUND_OFF:
        raise ReductionError(
            f"{whose} moves imposed dofs by {imposed:.1e} > {MODE_ROUND_OFF:g}: make its modes of "
            "snapshots.displacements"
        )
    broken = rows.largest(np.abs(basis - problem.prolonged(basis)).max(axis=1, initial=0.0))[1]
    if broken > MODE_ROUND_OFF:
        raise ReductionError(
            f"{whose} breaks constraints by {broken:.1e} > {MODE_ROUND_OFF:g}: make its modes of "
            "snapshots.displacements"
        )
    skew = float(np.abs(rows.sum(basis.T @ basis) - np.eye(basis.shape[1])).max())
    if skew > MODE_ROUND_OFF:
        raise ReductionError(
            f"{whose} is not orthonormal, by {skew:.1e} > {MODE_ROUND_OFF:g}: return "
            "np.linalg.qr(modes)[0]"
        )


def _outside(
    parts: tuple[np.ndarray, np.ndarray], column: np.ndarray, along: np.ndarray, rows: Rows
) -> np.ndarray | None:
    """Unit function orthogonal to a basis that adds a column to its span, (own,).

    The basis comes in two blocks, (own, ell) each.

    None if that lies inside. The column has unit length and is changed; ``along`` are its products
    with the basis.
    """
    for _ in range(
        2
        # twice is enough: the first pass leaves round-off of the original length, not of the
        # remainder
    ):
        for block, products in zip(parts, np.split(along, [parts[0].shape[1]]), strict=True):
            column -= block @ products
        length = math.sqrt(rows.sum(column @ column))
        if length <= DISTINCT:
            return None
        column /= length
        if length > LENGTH_LEFT:
            break
        along = rows.sum(np.concatenate([block.T @ column for block in parts]))
    return column


def record_enrichment(enrichment: Enrichment, kappa_max: float, log: StageLog) -> None:
    """Log whether there was an enrichment, why it stopped early, and the conditions left out.

    Args:
        enrichment: the enriched basis.
        kappa_max: condition number that was requested.
        log: log of the stages.
    """
    kappa = enrichment.kappas[-1]
    if count := len(enrichment.left_out):
        named = ", ".join(str(number) for number in enrichment.left_out[:5]) + ", ..." * (count > 5)
        log.skip(
            "enrichment_twins",
            (
                f"the functions of {count} contact conditions ({named}) lie in the span of the "
                "basis already"
            ),
        )
    if kappa > kappa_max:
        reason = "no function lowers it further" if enrichment.stalled else "no function is left"
        log.skip("further_enrichment", f"kappa(B~) = {kappa:.2f} > {kappa_max:g}, but {reason}")
    elif not len(enrichment.added):
        log.skip("enrichment", f"kappa(B~) = {kappa:.2f} <= {kappa_max:g} and (1.67) holds")


def _prolonged(
    problem: ContactProblem, dofs: np.ndarray, functions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Functions, (card dofs, c), with the dofs that follow theirs.

    Their dofs, (s,), and unit functions on these, (s, c).
    """
    coupling = problem.prolongation.map
    if coupling is None:
        return dofs, functions
    prolonged = csr_matrix(coupling[:, dofs] @ csr_matrix(functions))
    support = np.union1d(dofs, np.flatnonzero(np.diff(prolonged.indptr)))
    return support, normalised(prolonged[support].toarray().T).T


def _candidates(problem: ContactProblem, sets: IndexSets) -> np.ndarray:
    """Unit normal displacement of the slave node of each condition.

    Of its partners if that is imposed or used.

    It is used if another condition moves the same node in the same direction: the one without
    partners keeps it.

    Columns over A_c, (card A_c, N_lambda_C); zero where neither can move inside A.
    """
    rows = problem.contact[sets.A_lambda][:, sets.A_c].toarray()
    slaves = problem.contact_slaves[sets.A_lambda]
    on_slaves = rows * (sets.A_c // problem.block_size == slaves[:, None])
    partners = normalised(rows - on_slaves)
    on_slaves = normalised(on_slaves)
    lonely = ~partners.any(axis=1)
    for k in np.flatnonzero(~lonely):
        rivals = np.flatnonzero((slaves == slaves[k]) & (lonely | (np.arange(slaves.size) < k)))
        if (np.abs(on_slaves[rivals] @ on_slaves[k]) > 1 - DISTINCT).any():
            on_slaves[k] = 0.0
    return np.where(on_slaves.any(axis=1)[:, None], on_slaves, partners).T


@dataclass(frozen=True)
class _Table:
    """B~1 or B~2 of a basis that grows (m conditions, ell columns, c candidates)."""

    problem: ContactProblem
    rows: csr_matrix  #: B on some dofs, (m, k)
    part: np.ndarray  #: these dofs, (k,)
    values: np.ndarray  #: B~, (m, ell)
    outside: (
        np.ndarray
    )  #: images of candidates along directions that complete the range of B~, (missing, c)

    @classmethod
    def of(
        cls,
        problem: ContactProblem,
        rows: csr_matrix,
        basis: np.ndarray,
        part: np.ndarray,
        images: np.ndarray,
    ) -> _Table:
        """Table from local rows of a basis, (own, ell), and images of candidates, (m, c).

        Args:
            problem: the contact problem.
            rows: B on some dofs, (m, k).
            basis: local rows of the basis, (own, ell).
            part: these dofs, (k,).
            images: images of the candidates, (m, c).
        """
        values = rows @ problem.spread.at(basis, part)
        table = cls(problem, rows, part, values, np.zeros((0, images.shape[1])))
        return replace(table, outside=table.missing.T @ images)

    def grown(self, column: np.ndarray, chosen: int) -> _Table:
        """Table with one more column of the basis, from a candidate.

        While the rank is too small, one direction is removed from the outside part, as in a QR
        decomposition with pivots. No singular values are needed before rows are independent.

        Args:
            column: values of the column on the dofs of the table, (k,).
            chosen: number of the candidate.
        """
        images = self.outside
        direction = images[:, chosen]
        size = np.linalg.norm(direction)
        if size > DEPENDENT_ROWS * self.problem.contact_norm:
            # Householder's reflection onto the first coordinate, which is removed then
            normal = direction / size
            normal[0] += math.copysign(1.0, normal[0])
            images = (images - np.outer(normal, (2 / (normal @ normal)) * (normal @ images)))[1:]
        return replace(
            self, values=np.column_stack([self.values, self.rows @ column]), outside=images
        )

    @cached_property
    def spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """Left singular vectors, (m, m), and singular values, largest first."""
        full = self.values.shape[0] > self.values.shape[1]
        try:
            return linalg.svd(self.values, full_matrices=full)[:2]
        except (
            linalg.LinAlgError
        ):  # divide and conquer, the fast way, fails so for a few matrices of full precision
            return linalg.svd(self.values, full_matrices=full, lapack_driver="gesvd")[:2]

    @property
    def missing(self) -> np.ndarray:
        """Directions that complete the range of B~, by the numerical rank, (m, missing).

        A direction counts from the root of round-off on. Below, squares of singular values, by
        which candidates are compared, are round-off, and so may the direction itself be: the least
        important mode of a POD has that of answers over its singular value, up to 1e-9 with the
        usual tolerance.
        """
        directions, values = self.spectrum
        least = DISTINCT * max(values[0], self.problem.contact_norm)
        return directions[:, int((values > least).sum()) :]

    @property
    def kappa(self) -> float:
        """kappa(B~); infinite if directions are missing."""
        values = self.spectrum[1]
        return math.inf if self.missing.size else float(values[0] / values[-1])


def _kappa(tables: list[_Table]) -> float:
    """kappa(B~1); infinite unless both B~1 and B~2 have full rank."""
    if any(len(table.outside) for table in tables):  # no need for singular values
        return math.inf
    kappas = [table.kappa for table in tables]
    return kappas[0] if all(map(math.isfinite, kappas)) else math.inf


def _best(
    tables: list[_Table],
    images: np.ndarray,
    weights: np.ndarray,
    lengths: np.ndarray,
    pool: np.ndarray,
) -> int:
    """Index of the best of the candidates ``pool``.

    It raises a rank that is missing, or lowers kappa(B~1) most.

    They have images, (m, c), products with the basis, (ell, c), and lengths outside the basis,
    (c,).
    """
    for table in tables:
        if len(table.outside):
            return int((np.linalg.norm(table.outside[:, pool], axis=0) / lengths).argmax())
    new = [(images - table.values @ weights) / lengths for table in tables]
    for table, columns in zip(tables, new, strict=True):
        missing = table.missing
        if missing.size:  # to round-off, though no direction was missing
            return int(np.linalg.norm(missing.T @ columns, axis=0).argmax())
    directions, values = tables[0].spectrum
    smallest, largest = _extremes_after_update(values**2, (directions.T @ new[0]) ** 2)
    # the squares lose half of the digits: good enough to choose, not to report
    return int(np.argmax(smallest / largest))


def _extremes_after_update(
    squares: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest eigenvalue of diag(squares) + z z^T for each column z^2 of ``weights``.

    They are roots of the secular equation 1 + sum_i z_i^2 / (d_i - x) = 0: the smallest lies
    between the two smallest d_i, the largest between the largest d_i and d_i + |z|^2. Bisection for
    all columns at once.
    """

    def root(low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Root of the secular equation between two bounds, (c,).

        Args:
            low: lower bounds, (c,).
            high: upper bounds, (c,).
        """
        for _ in range(60):
            middle = 0.5 * (low + high)
            with np.errstate(divide="ignore", invalid="ignore"):
                above = 1 + np.sum(weights / (squares[:, None] - middle), axis=0) > 0
            low = np.where(above, low, middle)
            high = np.where(above, middle, high)
        return high

    total = weights.sum(axis=0)
    ones = np.ones(weights.shape[1])
    last = squares[-2] if squares.size > 1 else squares[-1] + total
    return root(squares[-1] * ones, last * ones), root(squares[0] * ones, squares[0] + total)
