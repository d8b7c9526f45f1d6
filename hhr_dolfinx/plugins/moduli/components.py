"""Connected components of a scene, each eliminated separately."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, hstack, spmatrix

from hhr_dolfinx.contact.problem import ContactProblem, dependence, moduli_of
from hhr_dolfinx.contact.stiffness import FactorStore
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.linear.sparse import FreeCholesky, low_rank_of, ordering_of
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.plugins.moduli.interpolate import (
    GridSettings,
    ProblemComponent,
    compliance_of,
    grown,
    round_off_of_gaps,
)
from hhr_dolfinx.plugins.moduli.interpolated import Compliances
from hhr_dolfinx.plugins.moduli.interpolation import FIRST_LEVELS, GrownGrid
from hhr_dolfinx.timing import Announce, unannounced

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.one_call.array_store import ArrayStore

LARGE_COMPONENT = 1e5
"""Number of dofs above which recomputed factors of a component take less of its time than of the
memory.
"""
WHOLLY = 1e-6
"""Part of a motion outside of a component, or in it, that is round-off."""
KNOWN_BYTES = 2e9
"""Memory for results of one component that are kept for later queries."""


@dataclass(frozen=True)
class Component:
    """A connected component of a scene."""

    number: int  #: its index among the components of the problem
    dofs: np.ndarray  #: its dofs that are free, as a mask, (N,)
    body: np.ndarray  #: numbers of all of its dofs
    part: ProblemComponent  #: conditions, loads and imposed displacements that act on it


def components_of(problem: ContactProblem) -> list[Component]:
    """Connected components of a scene that conditions, loads or imposed displacements act on."""
    components = []
    shape_axes = () if problem.reshaped is None else problem.reshaped.axes
    lifts = sum(abs(term) for term in problem.lift_terms)
    if problem.reshaped is not None:  # at another shape other dofs may have forces
        lifts = lifts + abs(problem.stiffness) @ abs(problem.lifts)
    for number, body in enumerate(problem.bodies):
        dofs = np.zeros(problem.free.size, dtype=bool)
        dofs[body] = problem.free[body]
        conditions = np.flatnonzero(np.diff(problem.contact[:, dofs].indptr))
        if not conditions.size:
            continue
        moduli = moduli_of(problem, body)
        factor, axes = dependence(moduli, shape_axes, problem.parameters.names)
        forced, lifted = (_acting(columns, dofs) for columns in (problem.external, lifts))
        scene_part = ProblemComponent(conditions, forced, lifted, factor, axes, tuple(moduli))
        components.append(Component(number, dofs, body, scene_part))
    return components


def kept(
    store: ArrayStore | None, called: str, compute: Callable[[], dict[str, np.ndarray]]
) -> dict[str, np.ndarray]:
    """Arrays by name, from a store if an interrupted run left them there.

    Else computed, and stored for another run.

    Args:
        store: the store; None without one.
        called: name of the arrays in the store.
        compute: returns the arrays by name.
    """
    arrays = None if store is None else store.load(called)
    if arrays is None:
        arrays = compute()
        if store is not None:
            store.save(called, arrays)
    return arrays


def _acting(columns: csc_matrix, dofs: np.ndarray) -> np.ndarray:
    """Columns with entries on some dofs."""
    return np.flatnonzero(np.diff(csc_matrix(columns[dofs]).indptr))


class ComponentSolver:
    """Computes S and the load response of one connected component.

    Its factors are updated at each point.

    If only moduli of whole bodies vary, the factors of the full model serve all points. Each rank
    of it has all rows. Columns of K^-1 B^T are used and discarded. A ``store`` keeps solutions for
    another run.
    """

    def __init__(self, full: FullModel, component: Component, store: ArrayStore | None = None):
        self.problem: ContactProblem = full.problem
        self.component = component
        self._full = full
        self._factors = FactorStore(self._factored)
        self._known: dict[bytes, dict[str, np.ndarray]] = {}
        self._work: dict[bytes, np.ndarray] = {}
        self._last: tuple[bytes, ContactProblem] | None = None
        self.store = store

    def __call__(self, point: np.ndarray) -> dict[str, np.ndarray]:
        """S_c, (m_c, m_c), and B K^-1 F above B K^-1 K lift, (T, m_c), for the factor 1.

        Kept while memory allows.
        """
        scene_part = self.component.part
        key = point[scene_part.axes].tobytes()
        arrays = self._known.get(key)
        if arrays is None:
            called = f"component {self.component.number} at {point[scene_part.axes].tolist()}"
            arrays = kept(
                self.store,
                called,
                self._scaled if self.serves_all else partial(self._solved, point),
            )
            if (work := arrays.pop("work", None)) is not None:
                self._work[key] = work
            # if only an exact factor changes, there is one solution, which models and bounds share
            if (
                self.serves_all
                or 8 * scene_part.conditions.size**2 * (len(self._known) + 1) <= KNOWN_BYTES
            ):
                self._known[key] = arrays
        return arrays

    def _solved(self, point: np.ndarray) -> dict[str, np.ndarray]:
        """Solve by factors that eliminate contact last, or by columns of K^-1 B^T.

        The columns serve loads too (symmetry).

        The former return the work of loads too.
        """
        problem = self._at(point)
        scene_part = self.component.part
        rows = csr_matrix(problem.contact[scene_part.conditions])
        acting = csr_matrix(self.acting(problem).T)
        with self._factors.of(problem.own_stiffness) as factors:
            rigid = self._rigid
            motions = None if rigid is None else factors.solve_columns(csc_matrix(rigid))
            schur = factors.between_last(csr_matrix(rows.multiply(self.component.dofs)))
            if schur is not None and rigid is None:
                responses = factors.solve_columns(acting.T)
                columns = (rows @ responses).T
                return self._normed(schur, columns, scene_part.factor_at(point)) | {
                    "work": acting @ responses
                }
            schur = np.empty((rows.shape[0],) * 2) if schur is None else schur
            columns = np.empty((acting.shape[0], rows.shape[0]))
            for indices, block in factors.solved_blocks(rows.T):
                schur[:, indices] = rows @ block
                columns[:, indices] = acting @ block
        if rigid is not None and motions is not None:
            schur, columns = without_motions(schur, columns, rows, acting, rigid, motions)
        return self._normed(schur, columns, scene_part.factor_at(point))

    def work(self, point: np.ndarray) -> np.ndarray:
        """Loads, and K times lifts, times their displacements, (T, T).

        Cached if the component was factored.
        """
        work = self._work.get(point[self.component.part.axes].tobytes())
        if work is None or self.serves_all:
            problem = self.with_stiffness(point)
            loads = self.acting(problem)
            work = loads.T @ self.solved_columns(problem, point, loads)
        return work

    def _scaled(self) -> dict[str, np.ndarray]:
        """Scale S of the full model from the middle of the box."""
        problem = self.problem
        scene_part = self.component.part
        rows = csr_matrix(problem.contact[scene_part.conditions])
        schur = self._full.stiffness.parts[self.component.number][
            np.ix_(scene_part.conditions, scene_part.conditions)
        ]
        acting = self.acting(problem)
        columns = (rows @ self.solved_columns(problem, problem.middle, acting)).T
        if (rigid := self._rigid) is not None:
            responses = self.solved_columns(problem, problem.middle, csc_matrix(rigid))
            schur, columns = without_motions(
                schur, columns, rows, csr_matrix(acting.T), rigid, responses
            )
        return self._normed(schur, columns, scene_part.factor_at(problem.middle))

    @cached_property
    def _rigid(self) -> np.ndarray | None:
        """Orthonormal motions of the component that its stiffness leaves, (N, k); None without any.

        NotOfferedError if they are motions of several components.
        """
        if self.problem.kernel is None:
            return None
        all_motions = np.hstack([self.problem.kernel.motions, self.problem.kernel.idle])
        motions = np.zeros_like(all_motions)
        motions[self.component.body] = all_motions[self.component.body]
        sizes = np.linalg.norm(motions, axis=0)
        if ((sizes > WHOLLY) & (sizes < 1 - WHOLLY)).any():
            raise NotOfferedError(
                "bodies move with others that constraints join, and contact alone holds them: "
                "components of the scene are eliminated one by one, which leaves no motion to "
                f"each: {self.problem.kernel.described}"
            )
        return motions[:, sizes > 0.5] if (sizes > 0.5).any() else None

    def _normed(
        self, schur: np.ndarray, columns: np.ndarray, factor: float
    ) -> dict[str, np.ndarray]:
        """Normalise to the factor 1; displacements by lifts do not depend on it."""
        columns[: self.component.part.forced.size] *= factor
        symmetric = schur + schur.T
        symmetric *= factor / 2
        return {"schur": symmetric, "columns": columns}

    def acting(self, problem: ContactProblem) -> csc_matrix:
        """Loads on the component, then K times its lifts, (N, T)."""
        scene_part = self.component.part
        pulls = problem.prolongation.restrict(problem.pulled[:, scene_part.lifted])
        return csc_matrix(hstack([problem.external[:, scene_part.forced], pulls]))

    def fields_at(self, point: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Displacements under contact forces, and under each load, (N, k + T).

        Args:
            point: parameters, (P,).
            forces: contact forces, (m, k).
        """
        problem = self._at(point)
        scene_part = self.component.part
        contact_loads = csc_matrix(
            problem.contact[scene_part.conditions].T @ forces[scene_part.conditions]
        )
        loads = problem.loads[:, np.union1d(scene_part.forced, scene_part.lifted)]
        return self.solved_columns(problem, point, hstack([contact_loads, loads], format="csc"))

    def fields_under(self, point: np.ndarray, points: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Displacements under loads and forces of solved points, with K of another point, (N, k).

        They are those of all components if the factors serve all of them.

        Args:
            point: parameters of K, (P,).
            points: parameters of the loads, (k, P).
            forces: contact forces, (k, m).
        """
        problem = self.with_stiffness(point)
        loaded = np.stack(
            [problem.external @ problem.amplitudes(query) for query in points], axis=1
        )
        columns = csc_matrix(loaded - problem.contact.T @ forces.T)
        return self.solved_together(problem, point, columns)

    def fields_of_lifts(self, point: np.ndarray) -> np.ndarray:
        """Displacements under K times its lifts, (N, T)."""
        problem = self.with_stiffness(point)
        drawn = problem.prolongation.restrict(problem.pulled[:, self.component.part.lifted])
        if self.serves_all:
            drawn *= self._scale(point)
        return self.solved_columns(problem, point, drawn)

    def release(self) -> None:
        """Free large factors: components are solved one after another."""
        if self.problem.free.size > LARGE_COMPONENT:
            self._last = None
            self._factors.release()

    def with_stiffness(self, point: np.ndarray) -> ContactProblem:
        """The problem at a point, with K of the component up to a factor.

        It is that of the middle if K is a multiple of the one there.
        """
        return self.problem if self.serves_all else self._at(point)

    def _at(self, point: np.ndarray) -> ContactProblem:
        """The problem at a point; the last one is kept, since its stiffness is factored."""
        key = point.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = None  # K may take half of the memory
            self._last = (key, self.problem.at(point))
        return self._last[1]

    @property
    def serves_all(self) -> bool:
        """True if its factors are those of all components: one solution serves them all."""
        return self._full.system.bodies is not None

    def _scale(self, point: np.ndarray) -> float:
        """K of the component at a point over K in the middle of the box."""
        bodies = self._full.system.bodies
        assert bodies is not None
        return float(bodies.at(point)[self.component.number])

    def solved_together(
        self, problem: ContactProblem, point: np.ndarray, columns: spmatrix
    ) -> np.ndarray:
        """K^-1 of all components at a point times columns, (N, k), if the factors serve all.

        Else of this one.

        Args:
            problem: the problem at this point.
            point: parameters, (P,).
            columns: right-hand sides, (N, k).
        """
        if self.serves_all:
            return self._full.system.stiffness(point).columns(columns)
        return self.solved_columns(problem, point, columns)

    def solved_columns(
        self, problem: ContactProblem, point: np.ndarray, columns: spmatrix
    ) -> np.ndarray:
        """K^-1 of the component times columns, (N, k).

        Args:
            problem: the problem at this point.
            point: parameters, (P,).
            columns: right-hand sides, (N, k).
        """
        if not self.serves_all:
            prolongation = problem.prolongation
            with self._factors.of(problem.own_stiffness) as factors:
                return prolongation.prolong(
                    factors.solve_columns(prolongation.restrict(csc_matrix(columns)))
                )
        dofs = self.component.dofs
        scale = self._scale(point)
        return self._full.stiffness.columns(csc_matrix(diags(dofs / scale) @ columns))

    def _factored(self, matrix: csr_matrix) -> FreeCholesky:
        """Factors of the component of a matrix."""
        full = self._full
        problem = self.problem
        if problem.free.size > LARGE_COMPONENT:
            full.store.release()
        dofs = self.component.dofs & problem.held
        low_rank = low_rank_of(problem.block_size, int(np.count_nonzero(dofs)), anew=True)
        last = np.unique(problem.contact[self.component.part.conditions].indices)
        name = full.scene.name
        if full.comm.size > 1:
            first: Any = full.store.first
            shared: FreeCholesky = full.group.factors(
                matrix, dofs, name, low_rank=low_rank, last=last, rows=first.rows
            )
            return shared
        options = (
            slice(0, problem.free.size),
            name,
            ordering_of(problem.block_size, "mumps"),
            full.comm,
        )
        return FreeCholesky(matrix, dofs, *options, low_rank=low_rank, last=last)


def without_motions(
    schur: np.ndarray,
    columns: np.ndarray,
    rows: csr_matrix,
    acting: csr_matrix,
    rigid: np.ndarray,
    pinned: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """B K^+ B^T and F^T K^+ B^T, without the rigid motions of a pinned component.

    K^+ = P K_pinned^-1 P leaves out the orthonormal motions R, with P = 1 - R R^T. On loads that
    balance it inverts K, whatever the pins are.

    Args:
        schur: B K_pinned^-1 B^T, (m, m).
        columns: F^T K_pinned^-1 B^T, (T, m).
        rows: B, (m, N).
        acting: loads F^T, (T, N).
        rigid: R, (N, k).
        pinned: K_pinned^-1 R, (N, k).
    """
    effect = rows @ rigid
    work = rigid.T @ pinned
    of_rows = rows @ pinned - 0.5 * effect @ work
    of_loads = acting @ pinned - 0.5 * (acting @ rigid) @ work
    changed = of_loads @ effect.T + (acting @ rigid) @ of_rows.T
    return schur - of_rows @ effect.T - effect @ of_rows.T, columns - changed


def interpolated_compliances(
    problem: ContactProblem,
    solvers: Sequence[ComponentSolver],
    settings: GridSettings,
    own: Sequence[GridSettings] = (),
    announce: Announce = unannounced,
    stage: str = "compliances",
    solve: Callable[
        [ComponentSolver, np.ndarray], Mapping[str, np.ndarray]
    ] = ComponentSolver.__call__,
) -> tuple[Compliances, list[GrownGrid], list[dict[str, np.ndarray]]]:
    """Compute and interpolate the compliances of all components of a full model, on one rank.

    Each solution is announced as a share of the fewest that the grids of all parts need.

    Args:
        problem: the contact problem.
        solvers: solver of each component.
        settings: targets of all grids, unless ``own`` has settings for each.
        own: targets of each grid; empty for the same.
        announce: reports progress.
        stage: name of the stage that is announced.
        solve: returns arrays by name of a component at a point.

    Returns:
        The compliances, their grids, and the modes of further arrays of each component.
    """
    fewest = sum(1 + FIRST_LEVELS * solver.component.part.axes.size for solver in solvers)
    done = count(1)

    def counted(solver: ComponentSolver, point: np.ndarray) -> Mapping[str, np.ndarray]:
        """Arrays of the component of a solver at a point, announced."""
        arrays = solve(solver, point)
        number = next(done)
        announce(stage, number / max(fewest, number + 1))
        return arrays

    compliances = []
    grids = []
    further = []
    for solver, grid_settings in zip(solvers, own or [settings] * len(solvers), strict=True):
        scene_part = solver.component.part
        grid, modes = grown(
            partial(counted, solver), problem.parameters, scene_part.axes, grid_settings, scene_part
        )
        solver.release()
        compliances.append(compliance_of(scene_part, grid, modes, None))
        grids.append(grid)
        further.append(
            {name: values for name, values in modes.items() if name not in ("schur", "columns")}
        )
    reshaped = None
    if problem.reshaped is not None:
        shapes = problem.reshaped.axes
        closed = {"gaps": round_off_of_gaps(problem)}
        grid, _ = grown(
            lambda point: {"gaps": problem.at(point).gaps},
            problem.parameters,
            shapes,
            settings,
            round_off=closed,
        )
        grids.append(grid)
        reshaped = grid.interpolant
    return (
        Compliances(tuple(compliances), problem.amplitudes, problem.gaps, reshaped),
        grids,
        further,
    )


def solvers_of(full: FullModel, store: ArrayStore | None = None) -> list[ComponentSolver]:
    """Solvers of all components of a full model.

    Args:
        full: the full model.
        store: keeps their solutions; None without one.
    """
    return [ComponentSolver(full, component, store) for component in components_of(full.problem)]
