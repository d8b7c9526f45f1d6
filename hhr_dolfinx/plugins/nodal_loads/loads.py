"""Nodes by their coordinates, and forces at nodes.

Bodies of decks are often held on lines of nodes or on single ones, and pulled at them. A
displacement takes the name of a set of nodes in the file of the mesh, or :class:`Nodes`; so does
:class:`NodalForce`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.amplitudes import Amplitude, check_amplitude
from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import SceneError, rounded
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.formulas import Formula
from hhr_dolfinx.loads import Assembler, Term
from hhr_dolfinx.parameters import Place, Tag, as_tuple, check_place, check_tag, is_number, is_whole

SAME = 1e-9
"""Part of the size of a mesh up to which distances differ by round-off, as those of nodes at one
place.
"""


@dataclass(frozen=True)
class Nodes(KnownArguments):
    """The nodes at which a function of the coordinates is true.

    ``Nodes(lambda x: np.isclose(x[0], 0))``.

    Attributes:
        where: function of coordinates, (dim, n), as of DOLFINx' ``locate_dofs_geometrical``, which
            returns (n,) bool. Coordinates are those of the given mesh, before any change of shape.

    Example:
        >>> points = np.array([[0.0, 0.0], [0.0, 1.0], [2.0, 1.0]])
        >>> hhr.Nodes(lambda x: np.isclose(x[0], 0)).nodes(points)
        array([0, 1])
        >>> hhr.Nodes.near((2.1, 1.0)).nodes(points)
        array([2])
    """

    where: Callable[[np.ndarray], np.ndarray]

    def __post_init__(self) -> None:
        if not callable(self.where):
            raise SceneError(
                f"Nodes({self.where!r}) needs a function of the coordinates, or Nodes.near((x, y, "
                "z))"
            )

    @classmethod
    def near(cls, point: Sequence[float]) -> Nearest:
        """The one node that is nearest to a point, (dim,).

        Several that are equally near are refused.
        """
        return Nearest(point)  # type: ignore[arg-type]

    def nodes(self, points: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.parameters.Place`.

        Args:
            points: coordinates of all nodes, (n, dim).

        Raises:
            SceneError: for a function that fails, or returns anything but one bool for each node.
        """
        try:
            selected = np.asarray(self.where(points.T))
        except Exception as error:  # a user's function raises anything
            raise SceneError(
                f"the function of {self!r} fails for coordinates {points.T.shape}: {error!r}"
            ) from error
        if selected.shape != (len(points),) or selected.dtype != bool:
            raise SceneError(
                f"the function of {self!r} must return one bool for each of {len(points)} nodes, "
                f"of coordinates of the shape {points.T.shape}, and returns {selected.dtype} of "
                f"the shape {selected.shape}"
            )
        return np.flatnonzero(selected)


@dataclass(frozen=True)
class Nearest:
    """The node that is nearest to a point; made by :meth:`Nodes.near`.

    Attributes:
        point: coordinates, (dim,).
    """

    point: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", as_tuple("the point of Nodes.near", self.point))
        if not all(is_number(value) for value in self.point):
            raise SceneError(f"Nodes.near{self.point} needs finite coordinates")

    def nodes(self, points: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.parameters.Place`.

        Args:
            points: coordinates of all nodes, (n, dim).

        Raises:
            SceneError: for a point of another dimension, or several nodes.
        """
        if len(self.point) != points.shape[1]:
            raise SceneError(
                f"Nodes.near{self.point} must have {points.shape[1]} coordinates, as the mesh"
            )
        away = np.linalg.norm(points - self.point, axis=1)
        near = np.flatnonzero(away <= away.min() + SAME * np.ptp(points, axis=0).max())
        if len(near) > 1:
            raise SceneError(
                f"{len(near)} nodes are equally near to Nodes.near{self.point}, at "
                f"{', '.join(str(rounded(coordinates)) for coordinates in points[near])}: "
                "round-off would choose. Give a point next to one of them; where bodies have nodes "
                "at one place, another place, or a set of nodes of the file of the mesh"
            )
        return near


@dataclass(frozen=True)
class NodalForce(KnownArguments):
    """A force ``amplitude(mu) * vector`` at each node of a set, ``*CLOAD`` of decks.

    In axisymmetry on its whole ring.

    Below a force at a point the displacement grows without limit as the mesh gets finer: give a
    pressure where it matters.

    Attributes:
        place: the name of a set of nodes in the file of the mesh, a tag of facets, or
            :class:`Nodes`.
        vector: the force, (dim,).
        amplitude: a number, an Amplitude, or a formula of the parameters as text.
    """

    place: Tag | Place
    vector: tuple[float, ...]
    amplitude: Amplitude | Formula = Amplitude(1.0)

    def __post_init__(self) -> None:
        check_place("nodal force", self.place)
        object.__setattr__(self, "vector", as_tuple("the vector of a nodal force", self.vector))
        if not all(is_number(value) for value in self.vector) or not any(self.vector):
            raise SceneError(
                f"the nodal force {self.vector} at {self.place!r} must be finite and not zero"
            )
        check_amplitude(self, f"the nodal force at {self.place!r}", formulas=True)

    def terms(self, assembler: Assembler) -> list[Term]:
        """One vector.

        Raises:
            SceneError: for a vector of another dimension than the mesh.
        """
        (dim,) = assembler.test.ufl_shape
        if len(self.vector) != dim:
            raise SceneError(
                f"the nodal force {self.vector} at {self.place!r} must have {dim} components, as "
                "the mesh"
            )
        dofs = dim * assembler.nodes(self.place)[:, None] + np.arange(dim)
        values = np.broadcast_to(self.vector, dofs.shape).ravel()
        columns = csc_matrix(
            (values, (dofs.ravel(), np.zeros(dofs.size, dtype=int))), shape=(assembler.size, 1)
        )
        return [Term(self.amplitude, columns)]


@dataclass(frozen=True)
class Springs(KnownArguments):
    """A spring to ground at each node, or a bedding per area.

    Forces are -k (u - amplitude) along a component.

    Attributes:
        place: the name of a set of nodes in the file of the mesh, a tag of facets, or
            :class:`Nodes`.
        component: 0, 1 or 2.
        modulus: k > 0 of each node, in force per length; of ``bedding`` per area.
        amplitude: displacement of the ground: a number, an Amplitude, or a formula of the
            parameters as text.
        bedding: True if k is one per area of the tagged facets, divided among their nodes by their
            areas.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> from hhr_dolfinx.geometries import block
        >>> side = block.side(0, upper=True)
        >>> spring = hhr.Springs(side, component=1, modulus=2e4, bedding=True)
        >>> model = hhr.condense(replace(scene, loads=(*scene.loads, spring)))
        >>> round(model.outputs({"push": 50.0})["peak"], 1)
        49.0
    """

    place: Tag | Place
    component: int
    modulus: float
    amplitude: Amplitude | Formula = Amplitude()
    bedding: bool = False

    def __post_init__(self) -> None:
        check_place("spring", self.place)
        if not is_whole(self.component, 0) or not is_number(self.modulus) or not self.modulus > 0:
            raise SceneError(f"{self!r} needs a component, 0, 1 or 2, and a positive modulus")
        check_amplitude(self, f"the spring at {self.place!r}", formulas=True)

    def stiffness(self, assembler: Assembler) -> np.ndarray:
        """See :class:`~hhr_dolfinx.loads.Load`.

        Raises:
            SceneError: for a component that the mesh does not have.
        """
        (dim,) = assembler.test.ufl_shape
        if self.component >= dim:
            raise SceneError(
                f"component {self.component} of {self!r} does not exist in {dim} dimensions"
            )
        diagonal = np.zeros(assembler.size)
        if self.bedding:
            check_tag("bedding", self.place)
            # the integral of each function: areas of contact differ from it on cells of second
            # order
            along = np.eye(dim)[self.component].tolist()
            ds = assembler.ds(self.place)  # type: ignore[arg-type]
            diagonal += self.modulus * assembler.vector(
                elasticity.traction(assembler.test, along, assembler.hypothesis, ds)
            )
        else:
            diagonal[dim * assembler.nodes(self.place) + self.component] = self.modulus
        return diagonal

    def terms(self, assembler: Assembler) -> list[Term]:
        """Forces of the ground that moves."""
        return [Term(self.amplitude, csc_matrix(self.stiffness(assembler)[:, None]))]
