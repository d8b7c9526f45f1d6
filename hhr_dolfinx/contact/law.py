"""Laws of interfaces: which forces contact conditions may have, and what they remember.

The core has one law, :class:`Unilateral`; a plug-in derives its own from :class:`ContactLaw`. A law
that remembers is answered along paths, by increments; its internal variables are parts of the
:class:`~hhr_dolfinx.memory.Memory` of an answer. What a law needs of histories, reductors and
reports are facets of its plug-in, see :func:`hhr_dolfinx.registry.facet`; a facet that is missing
refuses.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Statuses, active_set
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.memory import NO_MEMORY, Memory

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix, csr_matrix

    from hhr_dolfinx.contact.rows import ContactRows
    from hhr_dolfinx.parameters import ParameterSpace

LAW = MappingProxyType({"law": True})
"""Metadata of a field of a pairing that a plug-in reads as a law.

a scene is refused if no plug-in reads it.
"""


class MeshArrays(NamedTuple):
    """Coordinates of nodes, (nodes, dim), nodes of each cell, (cells, k), and degree of the
    displacement.
    """

    points: np.ndarray
    cells: np.ndarray
    order: int


class PairLaw(ABC):
    """A law of the plug-in ``plugin`` as a user gives it to a contact pair."""

    plugin: ClassVar[str]

    @property
    @abstractmethod
    def texts(self) -> tuple[str, ...]:
        """Formulas of the parameters on which it depends."""

    @property
    @abstractmethod
    def words(self) -> str:
        """Short description for the check of a scene."""

    @abstractmethod
    def check(self, scene: Any, what: str) -> None:
        """Check that a scene admits the law.

        Args:
            scene: the scene.
            what: description of the contact for the message.

        Raises:
            SceneError: if the scene does not admit the law.
        """

    @classmethod
    @abstractmethod
    def attached(
        cls,
        laws: Mapping[int, Any],
        scene: Any,
        rows: ContactRows,
        pairs: np.ndarray,
        free: np.ndarray,
        lifts: csc_matrix,
        mesh: MeshArrays,
    ) -> tuple[ContactRows, np.ndarray, ContactLaw]:
        """Append the rows of laws to the conditions of pressures.

        Args:
            laws: laws of pairs by their index in the scene.
            scene: the scene.
            rows: conditions of pressures.
            pairs: contact pair of each condition, (n,).
            free: True for dofs that are not imposed, (N,) bool.
            lifts: imposed displacements by term, (N, 1 + T).
            mesh: nodes and cells of the mesh.

        Returns:
            All rows, the pair of each, and the law on them.
        """


class StepContact(Protocol):
    """Solves the contact problems of the linearisations of one step, from its beginning."""

    def solved(
        self,
        equalities: SchurEqualities,
        free_slack: np.ndarray,
        active: np.ndarray,
        pairs: Pairs | None,
    ) -> Statuses:
        """Solve for the forces at one linearisation.

        Args:
            equalities: equality problems on S, (m, m).
            free_slack: slack without contact forces, (m,).
            active: statuses to start from, (m,) bool.
            pairs: contact pair of each condition; None takes all for one pair.
        """

    def changes(
        self, equalities: SchurEqualities, found: Statuses, slack: np.ndarray
    ) -> np.ndarray:
        """Derivatives of the last forces by those of the slack, (m, K).

        Args:
            equalities: equality problems on S, (m, m).
            found: outcome of the last search for statuses.
            slack: derivatives of the slack, (m, K).

        Raises:
            NotSolvableError, LinAlgError: if there are no derivatives.
        """

    def memory(self, unknown: np.ndarray) -> Memory:
        """Memory of the law after the step, by the last linearisation, at whose unknown it ends,
        (n,).
        """


class ContactLaw:
    """A law on the contact conditions of a problem, or on those that a model solves for.

    The methods here are those of unilateral contact, and so is no attribute: a law remembers.
    """

    plugin: ClassVar[str] = (
        ""  # name of its plug-in, whose facets complete it; empty for unilateral contact
    )
    name: ClassVar[str] = "unilateral contact"  #: description in messages
    remembers: ClassVar[bool] = True  #: whether answers depend on the path that leads to them
    #: whether its increments solve for the motions of bodies that contact alone holds; scenes with
    #: such bodies are refused otherwise
    floats: ClassVar[bool] = False
    #: whether it holds where areas of its contacts depend on parameters, on bodies with such
    #: shapes; scenes with them are refused otherwise
    reshapes: ClassVar[bool] = False

    fixed: np.ndarray  #: indices of the parameters that are constant while loads grow in proportion

    @property
    def path_dependent(self) -> bool:
        """True if answers depend on the path. If one law of several remembers, all answers do."""
        return self.remembers

    def pressing(self, count: int) -> np.ndarray:
        """Conditions with the force of a pressure among so many, (count,) bool."""
        return np.ones(count, dtype=bool)

    def pulling(self, count: int) -> np.ndarray:
        """Conditions whose force may pull among so many, (count,) bool."""
        return np.zeros(count, dtype=bool)

    def distinct(self, count: int) -> np.ndarray:
        """Conditions that no other one repeats among so many, (count,) bool."""
        return np.ones(count, dtype=bool)

    def kept_with(self, inside: np.ndarray, contact: csr_matrix) -> np.ndarray:
        """Conditions of a reduced domain, (N_lambda,) bool, with all rows that belong to them.

        Args:
            inside: conditions of the reduced domain, (N_lambda,) bool.
            contact: B, (N_lambda, N).
        """
        return inside

    def within(self, conditions: np.ndarray) -> ContactLaw:
        """The law on some conditions, (m,), in their order there."""
        return self

    @property
    def plugins(self) -> tuple[str, ...]:
        """Names of the plug-ins of the law, or of several laws in a scene.

        None of unilateral contact.
        """
        return (self.plugin,) if self.plugin else ()

    def of(self, plugin: str) -> ContactLaw | None:
        """The law of a plug-in, by its name, also in a scene with others.

        None if no condition has it.
        """
        return self if self.plugin == plugin else None

    def among(self, conditions: np.ndarray) -> ContactLaw:
        """The law on some conditions, (m,), with their numbers among all.

        One without numbers is the same.
        """
        return self

    def limited(
        self, forces: np.ndarray, changes: np.ndarray, fitted: np.ndarray, point: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Limit fitted forces to those that the law admits.

        Args:
            forces: forces, (m,).
            changes: their derivatives, (m, P).
            fitted: forces to limit, (m,) bool.
            point: parameters, (P,).

        Returns:
            Forces, derivatives and statuses, (m,) bool.
        """
        return forces, changes, forces > 0

    def parts(self) -> list[str | np.ndarray]:
        """Texts and arrays on which answers depend in addition to the rows, for a fingerprint."""
        return []

    def faults_for(self, dimension: int) -> Iterator[str]:
        """Faults of the law in a model with so many components of the displacement."""
        yield from ()

    def check_path(self, space: ParameterSpace, points: np.ndarray) -> None:
        """Check that the law has a meaning along a path.

        Args:
            space: the parameters.
            points: points of the path, (n, P).

        Raises:
            ParameterError: for points along which the law has no meaning.
        """

    def opened(self, memory: Memory) -> float | np.ndarray:
        """Part of the gaps that a memory adds, (m,), as a worn depth does, or 0.

        Outputs of gaps are without it.
        """
        return 0.0

    @property
    def layout(self) -> dict[str, tuple[str, ...]]:
        """Kind and sizes of each array of its memory in files, by name."""
        return {}

    @property
    def sizes(self) -> dict[str, int]:
        """Sizes that the layout names."""
        return {}

    def stored(self, memory: Memory) -> dict[str, np.ndarray]:
        """Arrays of a memory, by the names of the layout."""
        return {}

    def restored(self, arrays: Mapping[str, np.ndarray]) -> Memory:
        """Memory from the arrays of the layout."""
        return NO_MEMORY


@dataclass(frozen=True)
class Unilateral(ContactLaw):
    """Forces push, surfaces do not overlap, and at each condition the force or the slack is zero:
    thesis (1.21).

    It has no parameters, so ``fixed`` is empty.
    """

    remembers: ClassVar[bool] = False
    fixed: ClassVar[np.ndarray] = np.zeros(0, dtype=np.int64)  # type: ignore[misc]


UNILATERAL = Unilateral()


class _UnilateralStep:
    def solved(
        self,
        equalities: SchurEqualities,
        free_slack: np.ndarray,
        active: np.ndarray,
        pairs: Pairs | None,
    ) -> Statuses:
        """See :class:`StepContact`.

        Args:
            equalities: equality problems on S, (m, m).
            free_slack: slack without contact forces, (m,).
            active: statuses to start from, (m,) bool.
            pairs: contact pair of each condition.
        """
        return active_set(equalities, free_slack, active, pairs=pairs)

    def changes(
        self, equalities: SchurEqualities, found: Statuses, slack: np.ndarray
    ) -> np.ndarray:
        """See :class:`StepContact`.

        Args:
            equalities: equality problems on S, (m, m).
            found: outcome of the last search for statuses.
            slack: derivatives of the slack, (m, K).
        """
        return np.asarray(equalities.several(found.active, slack)[0])

    def memory(self, unknown: np.ndarray) -> Memory:
        return NO_MEMORY


UNILATERAL_STEP: StepContact = _UnilateralStep()


def check_attached(given: PairLaw, law: ContactLaw) -> None:
    """Check that the law on the conditions is that of a user's law, which would else be left out.

    Args:
        given: law of the user.
        law: law that its ``attached`` returned.

    Raises:
        SceneError: if the law is of another plug-in.
    """
    if isinstance(law, ContactLaw) and law.plugin == given.plugin:
        return
    raise SceneError(
        f"attached() of {type(given).__name__} returned {law!r}, and a contact law of the plug-in "
        f"'{given.plugin}', is needed: other models would leave out {given.words}. Return an "
        f"object of a class derived from ContactLaw, with plugin = '{given.plugin}'"
    )


def pair_law(pair: object, what: str) -> PairLaw | None:
    """Law of a pairing in addition to unilateral contact; None without one.

    It is the value of ``law``, of fields with :data:`LAW`, of those that plug-ins read, or any
    :class:`PairLaw`.

    Args:
        pair: the pairing.
        what: description of the pairing for messages.

    Raises:
        SceneError: for an invalid law, laws that do not go together, a law that no installed
            plug-in reads, or that of a pairing inside.
    """
    readers = registry.named("pair_laws")
    declared = fields(pair) if is_dataclass(pair) else ()
    values = dict(getattr(pair, "__dict__", {})) | {
        declared_field.name: getattr(pair, declared_field.name) for declared_field in declared
    }
    names = {
        declared_field.name for declared_field in declared if declared_field.metadata.get("law")
    }
    names |= {name for name, value in values.items() if isinstance(value, PairLaw)} | {"law"}
    stated = {
        name: value
        for name in sorted(names | readers.keys())
        if (value := getattr(pair, name, None)) is not None
    }
    for name, value in values.items():
        for inner in value if isinstance(value, tuple | list) else (value,):
            if (
                hasattr(inner, "rows")
                and hasattr(inner, "tags")
                and pair_law(inner, f"{name} of {what}") is not None
            ):
                raise SceneError(
                    f"{what} has a law inside of its {name}, {inner!r}, which nothing reads there: "
                    "give the outer pairing a field law, and the law to that"
                )
    laws: list[PairLaw] = []
    for name, value in stated.items():
        if not isinstance(value, PairLaw) and name in readers:
            value = registry.load(readers[name])(value, what)
        if not isinstance(value, PairLaw) or value.plugin not in registry.installed():
            remedy = registry.remedy("pair_laws", name) or ": install the one that does"
            raise SceneError(f"{what} has {name} = {value!r}, and no plug-in reads it{remedy}")
        laws.append(value)
    if len(laws) > 1:
        joined: PairLaw = registry.tool("laws_of_a_pair", f"{what} with several laws")(laws, what)
        return joined
    return laws[0] if laws else None
