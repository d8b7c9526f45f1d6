"""Recipe: the steps of a reduction, as typed objects.

A missing step is the default; None leaves out an optional one.

A user-defined basis is an object with ``modes(problem, snapshots)``, a choice of nodes one with
``nodes(problem, snapshots, basis)``, an indicator one with ``prepared(problem, basis, sets)``. They
are listed like those below.

On distributed problems each rank has the rows of its dofs. A basis or a choice of nodes for which
these suffice, see :class:`~hhr_dolfinx.linear.rows.Rows`, ``problem.spread``, sets ``by_rows =
True``; otherwise all ranks get all rows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from numbers import Real
from types import UnionType
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx import registry
from hhr_dolfinx.certify.trust import TrustLimits
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.group import ALONE, ProcessGroup
from hhr_dolfinx.linear.rows import Rows
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.parameters import is_whole
from hhr_dolfinx.reduction.enrichment import MODE_ROUND_OFF, check_basis
from hhr_dolfinx.reduction.modes import deim, pod
from hhr_dolfinx.reduction.projection import checked_nodes, load_nodes
from hhr_dolfinx.snapshots.records import SnapshotSet

if TYPE_CHECKING:
    from hhr_dolfinx.files import Json

MOST_LAYERS = 1000
"""Layers of cells that cover any mesh of this package."""


def _weights(sizes: np.ndarray) -> np.ndarray:
    """One over the norm of each column, 1 for columns of zeros."""
    return 1 / np.where(sizes > 0, sizes, 1.0)


def _sizes(columns: np.ndarray, gram: csr_matrix | None, rows: Rows) -> np.ndarray:
    """Norm of each column, (k,), by a Gram matrix; None is the Euclidean norm."""
    if gram is None:
        return rows.norms(columns)
    return np.sqrt(np.maximum(rows.sum(np.einsum("nk,nk->k", columns, gram @ columns)), 0.0))


def _cut(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Columns with zeros outside some rows."""
    result = np.zeros_like(columns)
    result[rows] = columns[rows]
    return result


class Basis(Protocol):
    """A choice of the basis of displacements.

    Ranks of a distributed problem return their rows of the same modes.
    """

    def modes(self, problem: ContactProblem, snapshots: SnapshotSet) -> np.ndarray:
        """V with orthonormal columns, most important first, zero on imposed dofs, (N, ell).

        Args:
            problem: the contact problem.
            snapshots: training answers.
        """


class NodeChoice(Protocol):
    """A choice of nodes, around which the RID is built.

    The same on all ranks of a distributed problem.
    """

    def nodes(
        self, problem: ContactProblem, snapshots: SnapshotSet, basis: np.ndarray
    ) -> np.ndarray:
        """Numbers of nodes, (n,).

        Args:
            problem: the contact problem.
            snapshots: training answers.
            basis: V, (own, ell).
        """


class Indicator(Protocol):
    """An estimate of the error of an answer."""

    def prepared(
        self, problem: ContactProblem, basis: np.ndarray, sets: IndexSets
    ) -> Callable[[Answer], float]:
        """Function from an answer to its estimate, with all offline work done.

        Args:
            problem: the contact problem.
            basis: V, (own, ell).
            sets: index sets of the RID.
        """


def _on_rows(*steps: Basis | NodeChoice) -> bool:
    """True if local rows of the displacements suffice for steps."""
    return all(getattr(step, "by_rows", False) is True for step in steps)


STEP_METHODS = {
    "modes": "modes(problem, snapshots), as Pod(1e-9) has",
    "nodes": "nodes(problem, snapshots, basis), as Deim() has",
    "prepared": "prepared(problem, basis, sets)",
}
"""Methods of steps, for messages."""


def _check_step(said: str, step: Basis | NodeChoice | Indicator, method: str) -> None:
    """Raise ReductionError for a step that is a class, or an object without a method."""
    if isinstance(step, type) or not callable(getattr(step, method, None)):
        raise ReductionError(f"{said} must have {STEP_METHODS[method]}")


@dataclass(frozen=True)
class Truncated:
    """Base of steps with a POD: ``tolerance`` is epsilon of (1.53), in (0, 1)."""

    tolerance: float

    def __post_init__(self) -> None:
        if not (isinstance(self.tolerance, Real) and 0 < float(self.tolerance) < 1):
            raise ReductionError(
                f"tolerance = {self.tolerance} of {type(self).__name__} must lie in (0, 1): it is "
                "the part of the snapshots left out"
            )
        for attribute in fields(self):
            value = getattr(self, attribute.name)
            if attribute.type in (bool, "bool") and not isinstance(value, bool):
                raise ReductionError(
                    f"{attribute.name} = {value!r} of {type(self).__name__} must be True or False"
                )


@dataclass(frozen=True)
class Pod(Truncated):
    """Proper orthogonal decomposition of the displacements, thesis (1.49)-(1.54).

    Attributes:
        relative: divide each snapshot by its norm first, so that grazing contact counts as much as
            strong contact; the thesis does not.
        norm: ``euclidean`` as in the thesis, ``energy`` or ``l2``.
        by_body: decompose each connected component separately, so that each mode moves one body
            only. Bodies joined by contact alone then share no entries of K~: a stiffness that
            depends on parameters is factored in blocks.
    """

    by_rows: ClassVar[bool] = True
    relative: bool = False
    norm: str = "euclidean"
    by_body: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.norm not in ("euclidean", "energy", "l2"):
            raise ReductionError(
                f"norm = '{self.norm}' of a Pod is unknown: 'euclidean', 'energy' or 'l2'"
            )

    def modes(self, problem: ContactProblem, snapshots: SnapshotSet) -> np.ndarray:
        """The leading modes, (N, ell).

        Args:
            problem: the contact problem.
            snapshots: training answers.
        """
        return self.of_columns(problem, snapshots.displacements)

    def of_columns(
        self, problem: ContactProblem, columns: np.ndarray, group: ProcessGroup = ALONE
    ) -> np.ndarray:
        """Modes of any displacements, (N, S).

        Processes share the bodies of a decomposition by body.

        Args:
            problem: the contact problem.
            columns: displacements, (N, S).
            group: processes that share the bodies.

        Raises:
            ReductionError: if no displacement is nonzero, or see
                :func:`~hhr_dolfinx.reduction.modes.pod`.
        """
        rows = problem.spread
        gram: csr_matrix | None = None  # the Euclidean norm
        if self.norm != "euclidean":
            gram = problem.stiffness_of_rows if self.norm == "energy" else rows.matrix(problem.mass)
        weights = _weights(_sizes(columns, gram, rows)) if self.relative else None

        def decomposed(block: np.ndarray, gram: csr_matrix | None, rows: Rows | None) -> np.ndarray:
            """Modes of some rows of the columns.

            Args:
                block: rows of the displacements, (k, S).
                gram: Gram matrix of these rows, (k, k); None for the Euclidean norm.
                rows: local rows; None if all are on this rank.
            """
            return pod(block if weights is None else block * weights, self.tolerance, gram, rows)[0]

        if not self.by_body:
            return decomposed(columns, gram, rows)
        bodies = [
            dofs for dofs in problem.bodies if rows.sum(float(columns[rows.mine(dofs)].any()))
        ]
        if not bodies:
            raise ReductionError(
                "nothing moves in any answer, so that no displacement is spanned: raise the loads"
            )
        if not rows.all_here:
            return np.hstack(
                [decomposed(_cut(columns, rows.mine(dofs)), gram, rows) for dofs in bodies]
            )

        def of_body(number: int) -> np.ndarray:
            dofs = bodies[number]
            return decomposed(columns[dofs], None if gram is None else gram[dofs][:, dofs], None)

        modes = group.shared_out(len(bodies), of_body, "decomposing displacements")
        ends = np.cumsum([0, *(block.shape[1] for block in modes)])
        basis = np.zeros((len(columns), ends[-1]))
        for dofs, block, (first, last) in zip(bodies, modes, pairwise(ends), strict=True):
            basis[dofs, first:last] = block
        return basis


@dataclass(frozen=True)
class Deim:
    """Nodes of the DEIM points of the basis, thesis Alg. 1.2.

    Attributes:
        pod: another POD whose modes give the points; None uses the basis itself. A larger basis on
            the nodes of a smaller one is the POD + FE enrichment of section 3.4.2.
    """

    pod: Pod | None = None

    def __post_init__(self) -> None:
        if self.pod is not None:
            _check_step(f"pod = {self.pod!r} of Deim", self.pod, "modes")

    def nodes(
        self, problem: ContactProblem, snapshots: SnapshotSet, basis: np.ndarray
    ) -> np.ndarray:
        """See :class:`NodeChoice`.

        Args:
            problem: the contact problem.
            snapshots: training answers.
            basis: V, (own, ell).
        """
        modes = basis if self.pod is None else self.pod.modes(problem, snapshots)
        return deim(modes, problem.spread) // problem.block_size

    @property
    def by_rows(self) -> bool:
        """See :class:`Pod`."""
        return self.pod is None or _on_rows(self.pod)


@dataclass(frozen=True)
class ForceDeim(Truncated):
    """Slave nodes of the contact conditions that DEIM picks, section 1.4.3.

    DEIM acts on a POD of the contact forces.

    Attributes:
        relative: divide the forces of each snapshot by the norm of its displacement first.
    """

    by_rows: ClassVar[bool] = True
    relative: bool = False

    def nodes(
        self, problem: ContactProblem, snapshots: SnapshotSet, basis: np.ndarray
    ) -> np.ndarray:
        """See :class:`NodeChoice`; without contact in training one slave node.

        A RID needs at least one condition.

        Args:
            problem: the contact problem.
            snapshots: training answers.
            basis: not used.
        """
        if not snapshots.any_contact(problem):
            return problem.contact_slaves[:1]
        weights = _weights(problem.spread.norms(snapshots.displacements)) if self.relative else 1.0
        return problem.contact_slaves[deim(pod(snapshots.forces * weights, self.tolerance)[0])]


@dataclass(frozen=True)
class LoadNodes:
    """One node for each load: a RID without any load would answer zero to every parameter."""

    by_rows: ClassVar[bool] = True

    def nodes(
        self, problem: ContactProblem, snapshots: SnapshotSet, basis: np.ndarray
    ) -> np.ndarray:
        """See :func:`~hhr_dolfinx.reduction.projection.load_nodes`.

        Args:
            problem: the contact problem.
            snapshots, basis: not used.
        """
        return load_nodes(problem)


@dataclass(frozen=True)
class Zone:
    """A zone of interest.

    Attributes:
        choose: maps the problem to node numbers, or to a mask of all nodes.
    """

    choose: Callable[[ContactProblem], np.ndarray]

    def __post_init__(self) -> None:
        if not callable(self.choose):
            raise ReductionError(
                "a zone is a function of the problem that returns node numbers: lambda problem: "
                "nodes"
            )

    def nodes(
        self, problem: ContactProblem, snapshots: SnapshotSet, basis: np.ndarray
    ) -> np.ndarray:
        """See :class:`NodeChoice`.

        Args:
            problem: the contact problem.
            snapshots, basis: not used.
        """
        return checked_nodes(np.asarray(self.choose(problem)), len(problem.points))


@dataclass(frozen=True)
class Rid:
    """The reduced integration domain around the nodes, thesis (1.55), section 5.2.3.

    Attributes:
        layers: layers of cells added around it.
        most_layers: layers up to which it may grow if the trust check fails.

    Example:
        >>> recipe = hhr.Recipe(domain=hhr.Rid(layers=1, most_layers=3))
        >>> recipe.as_it_is().domain
        Rid(layers=1, most_layers=1)
    """

    layers: int = 2
    most_layers: int = 4

    def __post_init__(self) -> None:
        for name in ("layers", "most_layers"):
            value = getattr(self, name)
            if not is_whole(value, 0) or value > MOST_LAYERS:
                raise ReductionError(
                    f"{name} = {value} must be a whole number of layers of cells, 0 to "
                    f"{MOST_LAYERS}"
                )


@dataclass(frozen=True)
class Enrich:
    """Enrichment by finite element functions of contact nodes, thesis Alg. 3.1.

    Attributes:
        kappa_max: kappa(B~) down to which functions are added.

    Example:
        >>> hhr.Recipe().enrichment
        Enrich(kappa_max=3.0)
        >>> hhr.Recipe(enrichment=hhr.Enrich(kappa_max=10.0)).described()["enrichment"]
        {'step': 'Enrich', 'kappa_max': 10.0}
    """

    kappa_max: float = 3.0

    def __post_init__(self) -> None:
        if not (
            isinstance(self.kappa_max, Real)
            and not isinstance(self.kappa_max, bool)
            and self.kappa_max >= 1
        ):
            raise ReductionError(
                f"kappa_max = {self.kappa_max} must be at least 1: no condition number is smaller"
            )


class _Named(type):
    """Class with named recipes of plug-ins, such as that for a law of interfaces."""

    def __getattr__(cls, name: str) -> Callable[..., Recipe]:
        import_paths = {} if name.startswith("_") else registry.named("recipes")
        if name not in import_paths:
            reason = registry.remedy("recipes", name) or ", and no installed plug-in adds it"
            raise AttributeError(f"there is no recipe {name!r}{reason}")
        return registry.load(import_paths[name])


@dataclass(frozen=True)
class Recipe(metaclass=_Named):
    """Steps of a reduction.

    The defaults gave the best errors for their time on the elastic pellet-cladding scene.

    Attributes:
        basis: of the displacements.
        nodes: choices of nodes for the RID, all of which are used.
        domain: the RID around them.
        enrichment: enrichment of the basis; None for none.
        trust: limits of the trust check; None leaves it out, to measure a model without it.
        indicator: estimates the error of each answer instead of a bound; None for none.
        bound: whether answers have a bound of their error, if its hypotheses hold.
        cone: whether forces outside the RID are combinations of training forces, (1.70), even if a
            bound has S. With S forces close their gaps: more exact, and fifty times as fast on the
            pellet.

    Example:
        >>> recipe = hhr.Recipe(basis=hhr.Pod(1e-9, relative=True), domain=hhr.Rid(layers=1))
        >>> recipe.described()["domain"]
        {'step': 'Rid', 'layers': 1, 'most_layers': 4}
        >>> hhr.Recipe.thesis(1e-8).enrichment
        Enrich(kappa_max=10.0)
    """

    basis: Basis = Pod(1e-13, relative=True)
    nodes: tuple[NodeChoice, ...] = (Deim(), ForceDeim(1e-6, relative=True), LoadNodes())
    domain: Rid = Rid()
    enrichment: Enrich | None = Enrich()
    trust: TrustLimits | None = TrustLimits()
    indicator: Indicator | None = None
    bound: bool = True
    cone: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.nodes, tuple | list) or not self.nodes:
            raise ReductionError(
                f"nodes = {self.nodes!r} must be a list of at least one choice: (Deim(), "
                "LoadNodes())"
            )
        object.__setattr__(self, "nodes", tuple(self.nodes))
        _check_step(f"basis = {self.basis!r}", self.basis, "modes")
        for step in self.nodes:
            _check_step(repr(step), step, "nodes")
        if self.indicator is not None:
            _check_step(f"indicator = {self.indicator!r}", self.indicator, "prepared")
        optional = {"enrichment": Enrich | None, "trust": TrustLimits | None}
        kinds: dict[str, type | UnionType] = {
            "domain": Rid,
            **optional,
            "bound": bool,
            "cone": bool,
        }
        for name, kind in kinds.items():
            if not isinstance(getattr(self, name), kind):
                raise ReductionError(f"{name} = {getattr(self, name)!r} of a recipe must be {kind}")

    @classmethod
    def thesis(cls, tolerance: float, **changes: Any) -> Recipe:
        """Recipe of the thesis.

        Plain snapshots, no DEIM of forces, no layers, no growth, kappa_max 10, (1.70).

        Args:
            tolerance: epsilon of the POD, (1.53).
            **changes: steps that replace those of the thesis, by name.
        """
        nodes = Deim(), LoadNodes()
        plain: dict[str, Any] = {
            "nodes": nodes,
            "domain": Rid(0, 0),
            "enrichment": Enrich(10.0),
            "cone": True,
        }
        return cls(Pod(tolerance), **(plain | changes))

    @property
    def by_rows(self) -> bool:
        """True if all of its steps can work on local rows."""
        return self.indicator is None and _on_rows(self.basis, *self.nodes)

    def as_it_is(self) -> Recipe:
        """Recipe without any check and without growth, to measure its result."""
        return replace(
            self, trust=None, domain=replace(self.domain, most_layers=self.domain.layers)
        )

    def described(self) -> dict[str, Json]:
        """Steps and their numbers as plain values, for a report; functions by their names."""
        return {attribute.name: _plain(getattr(self, attribute.name)) for attribute in fields(self)}


def _plain(value: object) -> Json:
    if hasattr(value, "__dataclass_fields__"):
        return {"step": type(value).__name__} | {
            name: _plain(getattr(value, name)) for name in value.__dataclass_fields__
        }
    if isinstance(value, tuple):
        return [_plain(element) for element in value]
    if isinstance(value, np.generic):
        return value.item()
    return (
        value
        if isinstance(value, bool | int | float | str | None)
        else getattr(value, "__name__", repr(value))
    )


def _prolonged(problem: ContactProblem, basis: np.ndarray) -> np.ndarray:
    """T V of a basis, (own, ell).

    Orthonormal again if a user-defined step does not know of the constraints.
    """
    rows = problem.spread
    prolonged = problem.prolonged(basis)
    change = rows.largest(np.abs(prolonged - basis).max(axis=1, initial=0.0))[1]
    return rows.orthonormal(prolonged)[0] if change > MODE_ROUND_OFF else prolonged


def basis_of(step: Basis, problem: ContactProblem, snapshots: SnapshotSet) -> np.ndarray:
    """Basis of a step, which may be user-defined, in the form of the equations.

    The kernel of K comes first.

    Args:
        step: the basis of a recipe, which may be user-defined.
        problem: the contact problem.
        snapshots: training answers.

    Returns:
        V, (own, ell).

    Raises:
        ReductionError: for modes of another shape, that are not finite, or that differ between
            ranks; or see :func:`~hhr_dolfinx.reduction.enrichment.check_basis`.
    """
    rows = problem.spread
    kernel = problem.kernel
    if kernel is not None:
        snapshots = replace(snapshots, displacements=kernel.without(rows, snapshots.displacements))
    basis = np.asarray(step.modes(problem, snapshots))
    free = rows.of(problem.prolongation.movable)
    shaped = basis.ndim == 2 and len(basis) == len(free) and 0 < basis.shape[1] <= len(problem.free)
    if rows.sum(float(not shaped or not np.isfinite(basis).all())):
        raise ReductionError(
            f"modes of {step!r} have the shape {basis.shape}: finite ones ({len(free)}, ell) are "
            "needed"
        )
    if not rows.alike(basis.shape[1]):
        raise ReductionError(
            f"{step!r} returned other numbers of modes on other ranks: give rows of the same modes"
        )
    basis = _prolonged(problem, basis)
    check_basis(problem, basis, f"the basis of {step!r}")
    if kernel is not None:
        basis = kernel.first(rows, basis)
    return np.where(free[:, None], basis, 0.0)  # without the round-off that the check allows


def chosen_nodes(
    problem: ContactProblem, snapshots: SnapshotSet, recipe: Recipe, basis: np.ndarray
) -> np.ndarray:
    """Numbers of the nodes around which the RID of a recipe is built, (n,).

    Args:
        problem: the contact problem.
        snapshots: training answers.
        recipe: the recipe, whose choices may be user-defined.
        basis: V, (own, ell).

    Raises:
        ReductionError: for invalid nodes, or nodes that differ between ranks.
    """
    choices = [
        checked_nodes(
            np.asarray(step.nodes(problem, snapshots, basis)), len(problem.points), repr(step)
        )
        for step in recipe.nodes
    ]
    holding = [] if problem.kernel is None else [problem.contact_slaves[problem.kernel.holding()]]
    nodes = np.unique(np.concatenate([*choices, *holding]))
    if not problem.spread.alike(nodes.tobytes()):
        raise ReductionError(
            "a step of the recipe chose other nodes on other ranks: choose the same of the whole "
            "mesh"
        )
    return nodes
