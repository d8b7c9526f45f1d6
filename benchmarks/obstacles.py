"""Scenes of other authors in which every node is a contact: rope, membrane, torsion.

    K u + λ = load f,    u <= gap(μ),    λ >= 0,    λ·(gap - u) = 0,    B = I and S = K^-1

- ``rope``: after B. Haasdonk, J. Salomon and B. Wohlmuth, SIAM J. Numer. Anal. 50 (2012): a rope
  above an obstacle with two hills that tilts. Where half of their stiffness is a parameter, here
  the load is one: rivals with supremizers need one K.
- ``membrane``: a square above a bowl of a depth (A. Benaceur, A. Ern and V. Ehrlacher, IJNME 121,
  2020, have one on 467 nodes); 71 x 71 nodes.
- ``torsion``: elastic-plastic torsion of a square bar: the stress function u has |grad u| <= yield,
  which is u <= yield * distance to the boundary (H. Brezis and M. Sibony, ARMA 41, 1971). Twist and
  yield are parameters.

The best full order eliminates the nodes that touch from K, which is sparse (primal-dual active set,
M. Hintermueller, K. Ito and K. Kunisch, SIAM J. Optim. 13, 2002), and may start from the statuses
of the nearest training answer. ``python benchmarks/rivals.py`` compares models on these scenes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, eye, kron
from scipy.sparse.linalg import splu

import hhr_dolfinx as hhr
from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.active_set import Status, Statuses
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.contact.prolongation import Prolongation
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.answer import Answer, ElasticFields, found_as
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.snapshots.records import SnapshotSet

MOST_STEPS = 500
"""Most linear problems of an answer of the full order."""


class Obstacle(NamedTuple):
    """K, and loads and gaps that are sums of columns: one free of parameters, one for each."""

    name: str
    stiffness: csc_matrix  #: K, (N, N)
    points: np.ndarray  #: places of the nodes, (N, dim)
    loads: np.ndarray  #: (N, 1 + P)
    gaps: np.ndarray  #: (N, 1 + P)
    parameters: hhr.ParameterSpace


def rope(nodes: int = 199) -> Obstacle:
    """A rope of length 1, pulled down, whose deflection is u; its load over its stiffness, and the
    slope of the obstacle.
    """
    x = np.linspace(0, 1, nodes + 2)[1:-1]
    hills = 0.5 + 0.2 * (np.sin(np.pi * x) - np.sin(3 * np.pi * x))
    nothing = np.zeros(nodes)
    size = 1.0 / (nodes + 1)
    return Obstacle(
        "rope",
        csc_matrix(_line(nodes) / size),
        x[:, None],
        np.column_stack([nothing, np.full(nodes, size), nothing]),
        np.column_stack([hills, nothing, -x]),
        hhr.ParameterSpace(("load", "tilt"), lower=(4.0, -0.05), upper=(20.0, 0.5)),
    )


def membrane(nodes: int = 71) -> Obstacle:
    """A square of side 1 and tension 1 above a bowl, by linear elements on right triangles."""
    stiffness, points, share = _square(nodes)
    bowl = 0.6 * ((points - 0.5) ** 2).sum(axis=1)
    nothing, same = np.zeros(len(points)), np.ones(len(points))
    return Obstacle(
        "membrane",
        stiffness,
        points,
        np.column_stack([nothing, share * same, nothing]),
        np.column_stack([bowl, nothing, same]),
        hhr.ParameterSpace(("load", "depth"), lower=(5.0, 0.02), upper=(20.0, 0.1)),
    )


def torsion(nodes: int = 71) -> Obstacle:
    """A bar of a square section of side 1 and shear modulus 1; its twist, and the stress at which
    it yields.
    """
    stiffness, points, share = _square(nodes)
    distance = np.minimum(points, 1 - points).min(axis=1)
    nothing = np.zeros(len(points))
    return Obstacle(
        "torsion",
        stiffness,
        points,
        np.column_stack([nothing, np.full(len(points), 2 * share), nothing]),
        np.column_stack([nothing, nothing, distance]),
        hhr.ParameterSpace(("twist", "yielding"), lower=(2.0, 0.8), upper=(8.0, 1.2)),
    )


SCENES = {"rope": rope, "membrane": membrane, "torsion": torsion}


def _line(nodes: int) -> csr_matrix:
    """Second differences, (n, n)."""
    sides = -np.ones(nodes - 1)
    return csr_matrix(diags([sides, np.full(nodes, 2.0), sides], [-1, 0, 1]))


def _square(nodes: int) -> tuple[csc_matrix, np.ndarray, float]:
    """K inside a unit square, (n², n²), its nodes, and the area of each."""
    line = np.linspace(0, 1, nodes + 2)[1:-1]
    x, y = np.meshgrid(line, line, indexing="ij")
    alone = eye(nodes)
    stiffness = csc_matrix(kron(alone, _line(nodes)) + kron(_line(nodes), alone))
    return stiffness, np.column_stack([x.ravel(), y.ravel()]), 1.0 / (nodes + 1) ** 2


class ObstacleModel(AnsweringModel, ElasticFields):
    """The best full order of an obstacle problem, with what rivals read of a full model."""

    functionals = None
    exact = True

    def __init__(self, obstacle: Obstacle):
        stiffness, count = csr_matrix(obstacle.stiffness), len(obstacle.points)
        self.parameters = obstacle.parameters
        terms = obstacle.loads.shape[1]
        nothing = csc_matrix((count, terms))
        slopes = np.vstack([np.zeros(terms - 1), np.eye(terms - 1)])
        self.problem = ContactProblem(
            stiffness_terms=(stiffness,),
            node_mass=csr_matrix(eye(count)),
            prolongation=Prolongation.of_free(np.ones(count, bool), nothing),
            forces=csc_matrix(obstacle.loads),
            pulls=(nothing,),
            contact=csr_matrix(eye(count)),
            gaps=obstacle.gaps,
            contact_slaves=np.arange(count),
            contact_pairs=np.zeros(count, int),
            contact_points=obstacle.points,
            contact_areas=np.ones(count),
            cell_nodes=np.arange(count)[:, None],
            points=obstacle.points,
            amplitudes=Amplitudes(np.eye(terms)[0], slopes),
            parameters=obstacle.parameters,
        )
        self.scene = SimpleNamespace(name=obstacle.name, system=obstacle)
        self.stiffness = Factored(_factors(obstacle.stiffness))
        self.fields = self
        self._rows = stiffness

    @property
    def full(self) -> Any:
        """The model itself."""
        return self

    @property
    def sizes(self) -> tuple[int, int]:
        """Dofs and conditions."""
        return self.problem.contact.shape

    @property
    def conditions(self) -> int:
        """Conditions, one at each node."""
        return len(self.problem.gaps)

    @cached_property
    def per_force(self) -> np.ndarray:
        """K^-1, which is S too, (N, N)."""
        return self.stiffness.columns(self.problem.contact.T)

    @property
    def schur(self) -> np.ndarray:
        """S, (N, N)."""
        return self.per_force

    def displacement(self, answer: Answer) -> np.ndarray:
        """The deflection, (N,)."""
        return answer.unknown

    def _answered(self, point, start, outside, gradient):
        if gradient:
            raise NotOfferedError("obstacle problems have no gradients here")
        theta = self.problem.amplitudes(point)
        loads, gaps = self.problem.loads @ theta, self.problem.gaps @ theta
        cold = start is None or isinstance(start, str)
        active = self.stiffness.solve(loads) > gaps if cold else np.array(start)
        count, before = 0, ~active
        while count < MOST_STEPS and (before != active).any():
            count, before = count + 1, active
            deflection = np.where(active, gaps, 0.0)
            free = np.flatnonzero(~active)
            rows = self._rows[free]
            if free.size:
                right = loads[free] - rows @ deflection
                deflection[free] = _factors(rows[:, free]).solve(right)
            forces = np.where(active, loads - self._rows @ deflection, 0.0)
            active = np.where(before, forces > 0, deflection > gaps)
        status = Status.CONVERGED if (before == active).all() else Status.ITERATION_LIMIT
        return found_as(Statuses(forces, active, count, status, False), point, deflection, self)


@dataclass(frozen=True)
class Factored:
    """K by its factors, as a full model has it."""

    factors: Any

    def solve(self, right: np.ndarray) -> np.ndarray:
        """K^-1 times a vector, (N,)."""
        return self.factors.solve(right)

    def columns(self, right: Any) -> np.ndarray:
        """K^-1 times the columns of a sparse matrix, (N, k)."""
        return self.factors.solve(right.toarray())


def _factors(matrix: Any) -> Any:
    """Factors of a symmetric positive definite matrix, without pivots."""
    options = {"SymmetricMode": True}
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


class ObstacleTraining:
    """Training answers on a grid, as rivals read them.

    Args:
        obstacle: the scene.
        counts: training points along each parameter.
        progress: makes progress bars.
    """

    def __init__(self, obstacle: Obstacle, counts: list[int], progress: Any):
        self.obstacle = obstacle
        self.full_order = ObstacleModel(obstacle)
        points = self.full_order.parameters.grid(counts)
        answers = [self.full_order.solve(point) for point in progress("snapshots")(points)]
        self.snapshots = SnapshotSet.of_answers(answers)

    def build(self, *recipe: Any, **how: Any) -> Any:
        """Refuse: a reduced integration domain is one of cells.

        Raises:
            NotOfferedError: always.
        """
        raise NotOfferedError("HHR cuts cells out of a mesh: these matrices have none")

    local = build

    def condense(self) -> Any:
        """The condensed model of the matrices."""
        terms = ["1", *self.obstacle.parameters.names]
        return hhr.condense_matrices(
            self.obstacle.parameters,
            self.obstacle.stiffness,
            eye(len(self.obstacle.points)),
            self.obstacle.loads,
            self.obstacle.gaps,
            terms,
        )


def bound_of(full: ObstacleModel, answer: Answer) -> tuple[float, float, float]:
    """Error of forces in the norm of S, its bound without the exact answer, and the size of forces.

    With e = λ - λ̂, û = K^-1 (F - λ̂), σ̂ = gap - û and its parts σ̂⁺, σ̂⁻ >= 0,

        |e|² <= λ̂·σ̂⁺ + |e| |σ̂⁻|_K,    so    |e| <= |σ̂⁻|_K / 2 + (|σ̂⁻|_K² / 4 + λ̂·σ̂⁺)^½,

    for any λ̂ >= 0: the norm of an overlap takes K, which is sparse.
    """
    problem = full.problem
    theta = problem.amplitudes(answer.parameter)
    forces = np.maximum(answer.forces(), 0.0)
    found = full.stiffness.solve(problem.loads @ theta - forces)
    slack = problem.gaps @ theta - found
    overlap = np.maximum(-slack, 0.0)
    deep = np.sqrt(overlap @ (full._rows @ overlap))
    idle = forces @ np.maximum(slack, 0.0)
    exact = full.solve(answer.parameter)
    off = exact.unknown - found
    size = exact.forces() @ full.stiffness.solve(exact.forces())
    error = np.sqrt(off @ (full._rows @ off))
    return float(error), float(deep / 2 + np.sqrt(deep**2 / 4 + idle)), float(np.sqrt(size))
