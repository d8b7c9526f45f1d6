"""Error indicators of greedy training, which need no full answer.

A user-defined indicator is an object with ``prepared(full)``, which returns a function of a reduced
model, the answers it was built from and some of its answers (histories, for inelastic bodies). The
function returns one number for each of them, or one vector whose norm counts: vectors also show
which errors have the same direction.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import ufl
from dolfinx.mesh import meshtags
from mpi4py import MPI
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.certify.accuracy import force_floor, norm
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, active_set
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets, masked
from hhr_dolfinx.contact.prolongation import Prolongation
from hhr_dolfinx.errors import LockingWarning, ReductionError, StudyError
from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.full_order.elasticity import elasticity_of
from hhr_dolfinx.linear.sparse import FreeCholesky
from hhr_dolfinx.models.answer import Answer, History
from hhr_dolfinx.reduction.reductor import Task, condensing, made
from hhr_dolfinx.snapshots.records import SnapshotSet
from hhr_dolfinx.warn import ignored

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.discretisation import Discretisation
    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.models.condensed import CondensedModel
    from hhr_dolfinx.models.reduced import ReducedModel
    from hhr_dolfinx.plugins.moduli.interpolate import GridSettings

Score = Callable[["ReducedModel", SnapshotSet, Sequence[Any]], np.ndarray]
"""Maps a reduced model, the answers it was built from, and some of its answers to indicators, (n,)
or (n, k).
"""

NO_ANSWER = np.inf
"""Indicator of a query without an answer."""


class GreedyIndicator(Protocol):
    """Estimate of the errors of answers."""

    def prepared(self, full: FullOrderModel) -> Score:
        """Compute all that does not depend on a reduced model.

        StudyError for an unsuitable full model.
        """


def _refuse_flow(full: FullOrderModel, name: str) -> None:
    if full.equilibrium is not None:
        raise StudyError(
            f"bodies of scene '{full.scene.name}' flow, and {name} judges single answers of "
            "elastic ones: take LargestEstimate()"
        )


@dataclass(frozen=True)
class LargestEstimate:
    """Estimates of answers: the larger of both relative errors of ``estimate()``.

    The largest one of a history.

    For an elastic answer it is a bound or nearly one, if its model has one. For a step of inelastic
    bodies it is the part of its stress that no mode of training explains; it follows the error of
    the stress, see docs/history_indicator.md.
    """

    def prepared(self, full: FullOrderModel) -> Score:
        """See :class:`GreedyIndicator`."""

        def score(
            model: ReducedModel, known: SnapshotSet, answers: Sequence[Answer | History | None]
        ) -> np.ndarray:
            """Largest estimate of each answer, (n,).

            Args:
                model: reduced model.
                known: answers it was built from.
                answers: some of its answers.
            """
            return np.array(
                [NO_ANSWER if query is None else self._of(query, full) for query in answers]
            )

        return score

    def _of(self, item: Answer | History, full: FullOrderModel) -> float:
        estimates = []
        for answer in item.answers if isinstance(item, History) else [item]:
            if not answer.converged:
                return NO_ANSWER
            estimate = answer.estimate()
            if estimate is None:
                raise StudyError(
                    f"answers of scene '{full.scene.name}' have no estimate: take another "
                    "indicator, ForceError()"
                )
            estimates.append(max(estimate.primal_relative, estimate.dual_relative))
        return max(estimates)


@dataclass(frozen=True)
class ForceError:
    """Error of all contact forces, a vector, against a condensed model with all conditions.

    For constant stiffness condensation is exact, and the indicator is the error. Otherwise
    condensation is interpolated between few parameters, and accurate to a small part of the
    tolerance. The denominator is at least a thousandth of the largest training forces.

    Attributes:
        settings: of the interpolation, a ``GridSettings``; None for the defaults.
    """

    settings: GridSettings | None = None

    def prepared(self, full: FullOrderModel) -> Score:
        """Indicator that compares forces with those of a condensed model.

        Args:
            full: the full model.

        Raises:
            StudyError: for inelastic bodies, and if elasticity varies where contact alone holds
                bodies.
        """
        _refuse_flow(full, "ForceError()")
        if full.problem.varies and full.problem.kernel is not None:
            raise StudyError(
                f"contact alone holds bodies of scene '{full.scene.name}', and their elasticity "
                "depends on parameters: nothing tells a greedy training how wrong its forces are "
                "there. Train on points of the whole box instead: Sobol(128), or --sobol 128 in a "
                "command"
            )
        condensed: list[CondensedModel] = []
        exact: dict[bytes, np.ndarray] = {}

        def score(model: ReducedModel, known: SnapshotSet, answers: Sequence[Answer]) -> np.ndarray:
            """Relative error of the forces of each answer, (n, m).

            Args:
                model: reduced model.
                known: answers it was built from.
                answers: some of its answers.
            """
            if not condensed:
                condensed.append(self._condensed(full, known))
            floor = force_floor(full.problem, known)

            def error(answer: Answer) -> np.ndarray:
                key = answer.parameter.tobytes()
                if key not in exact:
                    exact[key] = condensed[0].solve(answer.parameter, outside="ignore").forces()
                if not answer.converged:
                    return np.full(exact[key].shape, NO_ANSWER)
                size = max(float(np.linalg.norm(exact[key])), floor)
                return (answer.forces() - exact[key]) / (size or 1.0)

            return np.array([error(answer) for answer in answers])

        return score

    def _condensed(self, full: FullOrderModel, known: SnapshotSet) -> CondensedModel:
        if not full.problem.varies:
            from hhr_dolfinx.reduction.exact import exact_condensation

            return exact_condensation(full, known.known_statuses(), field=False)
        try:
            return made(condensing(full).usual(self.settings, fields=None), Task(full, known))
        except ReductionError as error:
            raise StudyError(
                f"scene '{full.scene.name}' cannot be condensed, {error}: choose by another "
                "indicator, such as Eta2()"
            ) from error


_OfAnswer = Callable[[Answer, np.ndarray], float]


@dataclass(frozen=True)
class Restriction:
    """The problem of a RID, whose free dofs are A.

    Dofs of its other nodes are imposed, including the interface I.
    """

    #: with U0 = 0 on imposed dofs; loads are those of A, conditions those of A_lambda, (1.21)
    problem: ContactProblem
    dofs: np.ndarray  #: number in the whole problem of each of its dofs, (n,)
    #: closure of each gap by unit values on imposed dofs, -B, sparse, (N_lambda_C, n)
    gap_of: csr_matrix


def restricted(problem: ContactProblem, sets: IndexSets) -> Restriction:
    """Cut the problem of a RID out of the whole one.

    For a RID of the whole domain return the whole problem. The RID is closed: no condition outside
    A_lambda acts on A.

    Args:
        problem: the problem on the whole mesh.
        sets: index sets of the RID.
    """
    problem.require_whole()
    size = problem.block_size
    nodes = np.union1d(problem.cell_nodes[sets.cells].ravel(), sets.A_c_tilde // size)
    dofs = (nodes[:, None] * size + np.arange(size)).ravel()
    free = np.isin(dofs, sets.A)
    number = np.full(len(problem.points), -1)
    number[nodes] = np.arange(nodes.size)
    rows = problem.contact[sets.A_lambda][:, dofs]
    rid_problem = replace(
        problem,
        stiffness_terms=tuple(term[dofs][:, dofs] for term in problem.stiffness_terms),
        node_mass=problem.node_mass[nodes][:, nodes],
        prolongation=Prolongation.of_free(free, csc_matrix(problem.lifts[dofs])),
        forces=csc_matrix(problem.external[dofs]),
        pulls=tuple(csc_matrix(term[dofs]) for term in problem.lift_terms),
        contact=csr_matrix(masked(rows.T, free).T),
        gaps=np.asfortranarray(problem.gaps[sets.A_lambda]),
        contact_slaves=number[problem.contact_slaves[sets.A_lambda]],
        contact_pairs=problem.contact_pairs[sets.A_lambda],
        contact_points=problem.contact_points[sets.A_lambda],
        contact_areas=problem.contact_areas[sets.A_lambda],
        cell_nodes=number[problem.cell_nodes[sets.cells]],
        points=problem.points[nodes],
        shares=None,
    )
    return Restriction(rid_problem, dofs, -csr_matrix(rows))


@dataclass(frozen=True)
class CellStiffness:
    """K of some cells alone at any point, without boundary conditions, (N, N).

    No cell outside adds to an interface.
    """

    part: Discretisation  #: the discretisation with the bodies of these cells
    terms: tuple[csr_matrix, ...]  #: parts of K on the mesh of the scene
    moduli: tuple[Modulus, ...]  #: of the parts; empty if K is constant

    @classmethod
    def of(cls, full: FullOrderModel, cells: np.ndarray) -> CellStiffness:
        """K of some cells of a full model. Collective.

        Args:
            full: the full model.
            cells: numbers of the cells, in the order of ``ContactProblem.cell_nodes``.
        """
        discretisation = _of_cells(full.discretisation, cells)
        return cls(discretisation, *_terms(discretisation))

    def at(self, point: np.ndarray) -> csr_matrix:
        """K of the cells at a point, (P,)."""
        terms = self.terms
        if self.part.scene.shapes:
            with self.part.shape.at(point):
                terms, _ = _terms(self.part)
        if not self.moduli:
            return terms[0]
        return sum(
            modulus.value(point) * term for modulus, term in zip(self.moduli, terms, strict=True)
        )


def _terms(part: Discretisation) -> tuple[tuple[csr_matrix, ...], tuple[Modulus, ...]]:
    """All rows of the parts of K."""
    terms, moduli = part.stiffness_terms()
    if part.group.size > 1:
        terms = tuple(part.group.stacked(term) for term in terms)
    return terms, moduli


def _of_cells(discretisation: Discretisation, cells: np.ndarray) -> Discretisation:
    """The discretisation without bodies in all other cells."""
    mesh = discretisation.mesh
    tags = discretisation._cell_tags
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    first = sum(discretisation.group.gathered(owned)[: discretisation.group.number])
    selected = np.isin(tags.indices, cells - first) & (tags.indices < owned)
    restricted = copy(discretisation)
    restricted._cell_tags = meshtags(
        mesh, mesh.topology.dim, tags.indices[selected], tags.values[selected]
    )
    restricted._dx = ufl.Measure("dx", domain=mesh, subdomain_data=restricted._cell_tags)
    with ignored(LockingWarning):  # building the model has warned
        restricted.elasticity = elasticity_of(restricted)
    return restricted


class _OnRid(ABC):
    """An indicator by the full equations of the RID.

    The displacement of its interface is interpolated, (1.72).
    """

    def prepared(self, full: FullOrderModel) -> Score:
        _refuse_flow(full, f"{type(self).__name__}()")

        def score(model: ReducedModel, known: SnapshotSet, answers: Sequence[Answer]) -> np.ndarray:
            """Indicator of each answer, (n,).

            Args:
                model: reduced model.
                known: answers it was built from.
                answers: some of its answers.
            """
            domain = _Domain(full.problem, model.offline.sets)
            interface = _interpolated(full.problem, known, answers, domain.interface)
            of = self.of_model(full, model, known, domain)
            pairs = zip(answers, interface, strict=True)
            return np.array(
                [
                    of(answer, interface_values) if answer.converged else NO_ANSWER
                    for answer, interface_values in pairs
                ]
            )

        return score

    @abstractmethod
    def of_model(
        self, full: FullOrderModel, model: ReducedModel, known: SnapshotSet, domain: _Domain
    ) -> _OfAnswer:
        """Indicator of an answer, by the displacement of the interface.

        Args:
            full: the full model.
            model: the reduced model.
            known: its training answers.
            domain: the RID of the model.
        """


@dataclass(frozen=True)
class Eta(_OnRid):
    """The indicator (1.73) of Fauque et al.

    (2018), from the full equations of the RID: eta_u + eta_λ.

    The displacement on the interface of the RID is interpolated between training answers, (1.72).
    The thesis interpolates on a regular grid. Points that are chosen one by one form none; radial
    functions r, which are exact at training points and linear in one parameter, replace it.

    Three things differ from (1.73). Its norms are of U; those here are of U0, the unknown without
    the imposed part. The forces in the denominator of eta_λ count as at least a thousandth of the
    largest of training, since forces near zero would choose every point without contact. If the
    interpolated interface penetrates, the thesis sets the gap to zero; here only the conditions of
    the RID are solved for.
    """

    def of_model(
        self, full: FullOrderModel, model: ReducedModel, known: SnapshotSet, domain: _Domain
    ) -> _OfAnswer:
        """See :class:`_OnRid`.

        Args:
            full: the full model.
            model: the reduced model.
            known: its training answers.
            domain: the RID of the model.
        """
        floor = force_floor(full.problem, known)

        def indicator(answer: Answer, there: np.ndarray) -> float:
            """Relative errors of the field and of the forces on the RID.

            Args:
                answer: answer of the model.
                there: interpolated field on the interface.
            """
            field, forces = domain.at(answer.parameter).solved(there, answer.parameter)
            difference = model.offline.basis[domain.inner] @ answer.unknown - field
            return _ratio(difference, field) + _ratio(answer.multipliers - forces, forces, floor)

        return indicator


@dataclass(frozen=True)
class Eta2(_OnRid):
    """The indicator (2.124) of the thesis.

    Residual on the RID, and jump on its interface to the interpolated field.

    It uses the energy norm of the cells of the RID, in which the form a has α = M_a = 1: |R|_{K^-1}
    + 2 |jump|_a. The printed number is absolute; here it is divided by the energy norm of the
    answer, so that candidates compare. The jump is that of U0; it is zero off the interface,
    (2.40), (2.123). The field is interpolated as for :class:`Eta`.
    """

    def of_model(
        self, full: FullOrderModel, model: ReducedModel, known: SnapshotSet, domain: _Domain
    ) -> _OfAnswer:
        """See :class:`_OnRid`.

        Args:
            full: the full model.
            model: the reduced model.
            known: its training answers.
            domain: the RID of the model.
        """
        stiffness = CellStiffness.of(full, model.offline.sets.cells)

        def indicator(answer: Answer, there: np.ndarray) -> float:
            """Residual on the RID and jump on its interface, relative to the answer.

            Args:
                answer: answer of the model.
                there: interpolated field on the interface.
            """
            equations = domain.at(answer.parameter)
            dofs = equations.part.dofs
            field = model.offline.basis[dofs] @ answer.unknown
            residual = equations.residual(field, answer.multipliers, answer.parameter)
            jump = np.zeros_like(field)
            jump[domain.places] = there - field[domain.places]
            stiffness_of_rid = stiffness.at(answer.parameter)[dofs][:, dofs]
            return (equations.dual(residual) + 2 * norm(jump, stiffness_of_rid)) / (
                norm(field, stiffness_of_rid) or 1.0
            )

        return indicator


def _ratio(error: np.ndarray, exact: np.ndarray, floor: float = 0.0) -> float:
    """Size of an error over that of the exact value, or a floor."""
    return float(np.linalg.norm(error)) / (max(float(np.linalg.norm(exact)), floor) or 1.0)


def _interpolated(
    problem: ContactProblem, known: SnapshotSet, answers: Sequence[Answer], dofs: np.ndarray
) -> np.ndarray:
    """U0 on some dofs between training answers, (n, dofs), see (1.72)."""
    from scipy.interpolate import RBFInterpolator

    lower, upper = np.array([problem.parameters.lower, problem.parameters.upper])
    points = np.array([answer.parameter for answer in answers]).reshape(len(answers), -1)
    between = RBFInterpolator(
        (known.points - lower) / (upper - lower),
        known.displacements[dofs].T,
        kernel="linear",
        degree=0,
    )
    return between((points - lower) / (upper - lower))


class _Domain:
    """The full equations of a RID at any point, factored once for constant stiffness."""

    def __init__(self, problem: ContactProblem, sets: IndexSets):
        self._problem = problem
        self._sets = sets
        restriction = restricted(problem, sets)
        self.places = np.flatnonzero(
            ~restriction.problem.free
        )  # indices of the interface among the dofs of the RID
        self.inner = restriction.dofs[restriction.problem.free]  # dofs of A, in the whole problem
        self.interface = restriction.dofs[
            self.places
        ]  # dofs of the RID outside A, in the whole problem
        self._constant = None if problem.varies else _RidEquations(restriction)

    def at(self, point: np.ndarray) -> _RidEquations:
        return self._constant or _RidEquations(restricted(self._problem.at(point), self._sets))


class _RidEquations:
    """The full equations of a RID, a restriction of the whole problem, at one stiffness."""

    def __init__(self, part: Restriction):
        self.part = part
        problem = part.problem
        all_rows = slice(0, problem.free.size)
        self._factors = FreeCholesky(
            problem.stiffness, problem.free, all_rows, "rid", "qmd", MPI.COMM_SELF
        )

    @cached_property
    def _contact(self) -> tuple[np.ndarray, SchurEqualities, Pairs | None]:
        """K^-1 B^T, the equality problems for forces, and their pairs."""
        problem = self.part.problem
        per_force = self._factors.solve_columns(problem.contact.T)
        return (
            per_force,
            SchurEqualities.of(problem.contact @ per_force),
            Pairs.of(problem.contact_pairs),
        )

    def solved(self, interface: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """U0 on A, and the forces of the RID, for U0 imposed on its interface, see (1.73).

        Args:
            interface: U0 on the interface.
            point: parameters, (P,).
        """
        problem = self.part.problem
        per_force, equalities, pairs = self._contact
        theta = problem.amplitudes(point)
        imposed = np.zeros(problem.free.size)
        imposed[~problem.free] = interface
        unloaded = self._factors.solve(problem.loads @ theta - problem.stiffness @ imposed)
        slack = problem.gaps @ theta + self.part.gap_of @ imposed - problem.contact @ unloaded
        statuses = active_set(equalities, slack, slack < 0, pairs=pairs)
        return (unloaded - per_force @ statuses.forces)[problem.free], statuses.forces

    def residual(self, field: np.ndarray, forces: np.ndarray, point: np.ndarray) -> np.ndarray:
        """R of (2.91) on A, 0 elsewhere.

        Args:
            field: U0 on the RID.
            forces: forces of the RID.
            point: parameters, (P,).
        """
        problem = self.part.problem
        residual = (
            problem.loads @ problem.amplitudes(point)
            - problem.stiffness @ field
            - problem.contact.T @ forces
        )
        return residual * problem.free

    def dual(self, residual: np.ndarray) -> float:
        """|R|_{K^-1}."""
        return float(np.sqrt(max(residual @ self._factors.solve(residual), 0.0)))
