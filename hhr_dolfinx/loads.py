"""Loads of a scene: each returns the vectors that it adds to F, and their amplitudes.

A user-defined load is one class with a method ``terms``, see :class:`Load`; other code depends on
the terms only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from scipy.sparse import csc_matrix, hstack, issparse

from hhr_dolfinx.amplitudes import (
    Amplitude,
    Amplitudes,
    Coverage,
    Limits,
    NonAffine,
    bound,
    check_amplitude,
    checked_count,
    edge_integrals,
)
from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.parameters import ParameterSpace, Tag, as_tuple, check_tag, is_number

if TYPE_CHECKING:
    import ufl
    from ufl.core.expr import Expr

    from hhr_dolfinx.formulas import Formula
    from hhr_dolfinx.pairings.surface import Surface


@dataclass(frozen=True)
class Term:
    """Columns of F with their amplitudes.

    Attributes:
        amplitude: affine or a formula, of a single column, or a
            :class:`~hhr_dolfinx.amplitudes.NonAffine` of several.
        columns: nodal forces for the amplitude 1, (N,), or sparse (N, k).
    """

    amplitude: Amplitude | Formula | NonAffine
    columns: np.ndarray | csc_matrix


@dataclass(frozen=True)
class Assembler:
    """Interface of the finite element model for loads; calls are collective."""

    test: ufl.Argument  #: UFL test function v, a vector
    #: ``plane_strain``, ``plane_stress``, ``axisymmetric`` or ``solid``: forms in axisymmetry need
    #: the weight :func:`hhr_dolfinx.forms.elasticity.volume_weight`
    hypothesis: str
    parameters: ParameterSpace  #: box of the parameters
    size: int  #: N, number of dofs; those of node n are ``dim n`` to ``dim n + dim - 1``
    #: measure of the outer facets with a tag; refuses missing tags and facets inside the mesh
    ds: Callable[[Tag], ufl.Measure]
    dx: Callable[[Tag], ufl.Measure]  #: measure of the cells with a tag
    vector: Callable[
        [ufl.Form], np.ndarray
    ]  #: assembles a UFL form that is linear in v, (N,); refuses other forms
    surface: Callable[
        [Tag], Surface
    ]  #: nodes of the facets with a tag, their coordinates and measures
    #: numbers of the nodes of a surface, of a set or of a place, (k,); of a set of nodes those that
    #: it lists, with ``whole=True`` all of the facets that it holds
    nodes: Callable[..., np.ndarray]
    points: Callable[[], np.ndarray]  #: coordinates of all nodes, (nodes, dim)
    cells: Callable[
        [], np.ndarray
    ]  #: numbers of the nodes of all cells, (cells, k), in the order of DOLFINx
    #: nodal forces of an eigenstrain, a UFL tensor 3x3, of the body with a tag: pairs of a modulus,
    #: which is a formula of the parameters, and the forces for the modulus 1, (N,)
    eigenstress: Callable[[Tag, Expr], Sequence[tuple[Formula, np.ndarray]]]


class Load(Protocol):
    """Interface of a load.

    A scene checks that an affine ``amplitude``, or one that is a formula, names parameters of the
    box, and calls the methods ``check(parameters)`` and ``check_scene(scene)``, if there are any,
    for checks that raise SceneError. A load that resists, as a spring, has a method
    ``stiffness(assembler)``: its stiffness to ground of each dof, (N,). A load that is an
    eigenstrain has a method ``eigenstrain_of(tag, mesh)``, which stresses subtract: its amplitude
    and its strain for amplitude 1, a UFL tensor 3x3, or None where the body with the tag has none.
    """

    def terms(self, assembler: Assembler) -> Sequence[Term]:
        """Terms that the load adds to F."""


@dataclass(frozen=True)
class Traction(KnownArguments):
    """Surface force ``amplitude(mu) * direction`` per area on tagged facets.

    The amplitude is a number, an :class:`Amplitude`, or a formula of the parameters as text, ``"0.6
    * speed**2"``.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> from hhr_dolfinx.geometries import block
        >>> pull = hhr.Traction(block.side(0, upper=True), direction=(0, 1), amplitude="0.1 * push")
        >>> model = hhr.condense(replace(scene, loads=(*scene.loads, pull)))
        >>> round(model.outputs({"push": 50.0})["peak"], 1)
        48.7
    """

    tag: Tag
    direction: tuple[float, ...]
    amplitude: Amplitude | Formula

    def __post_init__(self):
        check_tag("traction", self.tag)
        object.__setattr__(
            self, "direction", as_tuple("the direction of a traction", self.direction)
        )
        if not all(is_number(value) for value in self.direction) or not any(self.direction):
            raise SceneError(
                f"the traction {self.direction} on tag {self.tag} must be finite and not zero"
            )
        check_amplitude(self, f"the traction on tag {self.tag}", formulas=True)

    def terms(self, assembler: Assembler) -> list[Term]:
        """One vector.

        Raises:
            SceneError: if the direction does not have the dimension of the mesh.
        """
        (dim,) = assembler.test.ufl_shape
        if len(self.direction) != dim:
            raise SceneError(
                f"the traction {self.direction} on tag {self.tag} must have {dim} components, as "
                "the mesh"
            )
        form = elasticity.traction(
            assembler.test, self.direction, assembler.hypothesis, assembler.ds(self.tag)
        )
        return [Term(self.amplitude, assembler.vector(form))]


@dataclass(frozen=True)
class Pressure(KnownArguments):
    """Pressure ``amplitude(mu)`` against the outer normal of tagged facets.

    The amplitude as that of a traction.

    Example:
        >>> hhr.Pressure("bore", 15.0)
        Pressure(tag='bore', amplitude=Amplitude(constant=15.0, slopes={}))
        >>> hhr.Pressure("bore", "p0 * (1 - leak)").amplitude.variables
        ('p0', 'leak')
    """

    tag: Tag
    amplitude: Amplitude | Formula

    def __post_init__(self):
        check_tag("pressure", self.tag)
        check_amplitude(self, f"the pressure on tag {self.tag}", formulas=True)

    def terms(self, assembler: Assembler) -> list[Term]:
        """One vector."""
        return [Term(self.amplitude, _unit_pressure(assembler, self.tag))]


@dataclass(frozen=True)
class PartialPressure(KnownArguments):
    """Pressure on the part of a straight line with coordinate up to a parameter, in two dimensions.

    It is integrated exactly over the partly covered edge, and evaluated online from few columns. A
    line of n nodes needs about n^2 / 2 numbers.

    Attributes:
        tag: facet tag of the line, which runs along an axis.
        amplitude: the pressure.
        extent: name of the parameter up to which the pressure acts.
        axis: coordinate along the line.
    """

    tag: Tag
    amplitude: Amplitude
    extent: str
    axis: int = 1

    def __post_init__(self):
        check_tag("partial pressure", self.tag)
        check_amplitude(self, f"the partial pressure on tag {self.tag}")
        if self.axis not in (0, 1):
            raise SceneError(
                f"the axis {self.axis!r} of the partial pressure on tag {self.tag} must be 0 or 1"
            )

    def check(self, parameters: ParameterSpace) -> None:
        """Check that the extent is a parameter.

        Raises:
            SceneError: if it is not one.
        """
        if self.extent not in parameters.names:
            raise SceneError(
                f"the partial pressure on tag {self.tag} extends up to '{self.extent}': it must "
                f"be one of the parameters {parameters.names}"
            )

    def terms(self, assembler: Assembler) -> list[Term]:
        """Columns in the order of :class:`~hhr_dolfinx.amplitudes.Coverage`.

        Raises:
            SceneError: if the line is not straight along the axis or not in one piece, or for a
                mesh in space.
        """
        nodal_forces = _unit_pressure(assembler, self.tag)
        line = assembler.surface(self.tag)
        degree = 1 if line.quadratic is None else 2
        self._check_line(line.points, assembler.hypothesis)
        order = np.argsort(line.points[:, self.axis])
        nodes = line.nodes[order]
        positions = line.points[order, self.axis]
        lengths = np.diff(positions[::degree])
        edges = np.arange(lengths.size)
        of_edges = csc_matrix((nodes.size, lengths.size))
        for number, integral in enumerate(edge_integrals(degree, 1.0)):
            of_edges += csc_matrix(
                (integral * lengths, (degree * edges + number, edges)), shape=of_edges.shape
            )
        nodal = np.asarray(of_edges.sum(axis=1)).ravel()
        nodal_forces = nodal_forces.reshape(-1, 2)[nodes]
        # force of a unit pressure per unit length: the same at every node of a straight line along
        # an axis
        force = nodal_forces.sum(axis=0) / nodal.sum()
        if np.abs(nodal_forces - nodal[:, None] * force).max() > 1e-9 * np.abs(nodal_forces).max():
            ends = positions[[0, -1]]
            start, end = np.where(
                np.abs(ends) > 1e-12 * np.abs(ends).max(), ends, 0.0
            )  # drops round-off of a mesher
            raise SceneError(
                f"the line tagged {self.tag} under a partial pressure is not in one piece from "
                f"{start:g} to {end:g} along axis {self.axis}: give each piece its "
                "own tag and pressure"
            )
        rows = (2 * nodes[:, None] + [0, 1]).ravel()
        entries = np.tile(force, nodes.size), (rows, np.repeat(np.arange(nodes.size), 2))
        at_nodes = csc_matrix(entries, shape=(assembler.size, nodes.size))
        before = at_nodes @ of_edges @ csc_matrix(np.triu(np.ones((lengths.size,) * 2), 1))
        space = assembler.parameters
        amplitude = self.amplitude
        extent = space.names.index(self.extent)
        coverage = Coverage(positions, extent, amplitude.constant, amplitude.row(space), degree)
        return [Term(coverage, hstack([before, at_nodes]))]

    def _check_line(self, points: np.ndarray, hypothesis: str) -> None:
        """Check that nodes, (n, dim), form a straight line along the axis in the plane.

        Raises SceneError otherwise.
        """
        label = f"the partial pressure on tag {self.tag}"
        if points.shape[1] != 2:
            raise SceneError(
                f"{label} needs a mesh in the plane: in space, write your own load with terms"
            )
        extents = np.ptp(points, axis=0)
        if extents[1 - self.axis] > 1e-9 * extents[self.axis]:
            raise SceneError(
                f"{label} acts along axis {self.axis}, and its line is not straight along it: it "
                f"extends over {extents[0]:.6g} along axis 0 and {extents[1]:.6g} along axis 1. "
                f"Set its axis to {extents.argmax()}, or tag a straight line"
            )
        if hypothesis == "axisymmetric" and self.axis == 0:
            raise SceneError(
                f"{label} acts along the radius of an axisymmetric scene, where its area is not "
                "linear in its extent: only lines along axis 1 are supported"
            )


def _unit_pressure(assembler: Assembler, tag: Tag) -> np.ndarray:
    return assembler.vector(
        elasticity.pressure(assembler.test, assembler.hypothesis, assembler.ds(tag))
    )


def checked_terms(load: Load, assembler: Assembler) -> list[Term]:
    """Terms of a load with columns in the format csc, without zeros.

    Args:
        load: the load.
        assembler: interface of the finite element model.

    Raises:
        SceneError: for terms, amplitudes or columns that are invalid.
    """
    terms = load.terms(assembler)
    if not isinstance(terms, Sequence) or not all(isinstance(term, Term) for term in terms):
        raise SceneError(f"the terms of {load!r} must be a list of Term, and are {terms!r}")
    bound_terms = [(bound(term.amplitude, assembler.parameters), term.columns) for term in terms]
    return [
        Term(amplitude, _checked_columns(load, amplitude, columns, assembler))
        for amplitude, columns in bound_terms
    ]


class Terms:
    """All terms of θ in their order, which is known here alone.

    The constant 1 comes first, then affine amplitudes, then others; both parts follow the order of
    the groups, and terms keep theirs within a group. A group has a name: ``imposed`` displacements,
    ``gaps``, or ``loads``.
    """

    def __init__(self, space: ParameterSpace, **groups: Sequence[Term]):
        self._space = space
        listed = [
            (name, index, Term(bound(term.amplitude, space), csc_matrix(term.columns)))
            for name, terms in groups.items()
            for index, term in enumerate(terms)
        ]
        self._listed = sorted(listed, key=lambda item: not isinstance(item[2].amplitude, Amplitude))

    def amplitudes(self, limits: tuple[Limits, ...] = ()) -> Amplitudes:
        """θ as a function of the parameters."""
        return Amplitudes.collect(
            [term.amplitude for _, _, term in self._listed], self._space, limits
        )

    def columns(
        self, group: str, rows: int, others: Sequence[csc_matrix] | None = None
    ) -> csc_matrix:
        """Columns of a group, each at the index of its term, zero elsewhere, csc, (rows, 1 + T).

        Args:
            group: name of the group.
            rows: number of rows.
            others: columns that replace those of the terms, in the order of the group.
        """
        blocks = [csc_matrix((rows, 1))]
        for name, index, term in self._listed:
            if name == group:
                blocks.append(term.columns if others is None else others[index])
            else:
                blocks.append(csc_matrix((rows, term.columns.shape[1])))
        return csc_matrix(hstack(blocks))


def _checked_columns(
    load: Load,
    amplitude: Amplitude | NonAffine,
    columns: np.ndarray | csc_matrix,
    assembler: Assembler,
) -> csc_matrix:
    count = (
        1
        if isinstance(amplitude, Amplitude)
        else checked_count(amplitude, assembler.parameters, load)
    )
    if isinstance(columns, np.ndarray) and columns.ndim == 1:
        columns = columns[:, None]
    shape = getattr(columns, "shape", None)
    if not (isinstance(columns, np.ndarray) or issparse(columns)) or shape != (
        assembler.size,
        count,
    ):
        raise SceneError(
            f"a term of {load!r} has {count} amplitudes: its columns must be an array or a sparse "
            f"matrix of shape {(assembler.size, count)}, not {columns!r}"
        )
    columns = csc_matrix(columns, dtype=float)
    columns.sum_duplicates()
    columns.eliminate_zeros()
    if not np.isfinite(columns.data).all():
        raise SceneError(f"the nodal forces of {load!r} are not finite: check its form")
    return columns
