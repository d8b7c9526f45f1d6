"""Preload of bolts: the two sides of a section are drawn together by a length or a force,
*PRE-TENSION SECTION.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix
from scipy.spatial import cKDTree

from hhr_dolfinx.amplitudes import Amplitude, check_amplitude
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import Formula
from hhr_dolfinx.loads import Assembler, Term
from hhr_dolfinx.pairings.surface import mean_normal
from hhr_dolfinx.parameters import check_tag
from hhr_dolfinx.plugins.constraints.cut import OTHER_SIDE
from hhr_dolfinx.plugins.constraints.elimination import ConstraintEquations

if TYPE_CHECKING:
    from hhr_dolfinx.scene import Scene


@dataclass(frozen=True)
class _Section:
    """Pairs of nodes on both sides of a section, and its normal."""

    below: np.ndarray  #: nodes of the first side, (n,)
    above: np.ndarray  #: their partners, (n,)
    normal: np.ndarray  #: from the first side to the other, (dim,)
    first: int  #: number of the pair in the middle

    @classmethod
    def of(cls, assembler: Assembler, name: str) -> _Section:
        """Section of a name.

        Args:
            assembler: interface of the mesh.
            name: name of the section.

        Raises:
            SceneError: for sides whose nodes do not coincide.
        """
        below, above = (assembler.surface(tag) for tag in (name, f"{name}{OTHER_SIDE}"))
        far, partner = cKDTree(above.points).query(below.points)
        if (
            len(below.nodes) != len(above.nodes)
            or far.max() > 1e-9 * np.ptp(below.points, axis=0).max()
        ):
            raise SceneError(
                f"the sides of section {name!r} have other nodes: cut the mesh by CutMesh(path, "
                "sections)"
            )
        first = int(np.linalg.norm(below.points - below.points.mean(axis=0), axis=1).argmin())
        return cls(below.nodes, above.nodes[partner], mean_normal(below), first)

    def dofs(self, nodes: np.ndarray) -> np.ndarray:
        """Dofs of nodes, (n,), one after another: (n dim,)."""
        dim = self.normal.size
        return (dim * nodes[:, None] + np.arange(dim)).ravel()

    def openings(self, size: int) -> csr_matrix:
        """Rows, (n dim, N), of the displacement of the upper side less that of the lower one."""
        dofs = np.concatenate([self.dofs(self.above), self.dofs(self.below)])
        rows = np.arange(dofs.size // 2)
        ones = np.ones(rows.size)
        return csr_matrix(
            (np.append(ones, -ones), (np.append(rows, rows), dofs)), shape=(rows.size, size)
        )


@dataclass(frozen=True)
class Preload:
    """Both sides of a section move alike, but for a shortening of the bolt along its normal.

    Attributes:
        section: name of the section, see :class:`~hhr_dolfinx.plugins.constraints.cut.CutMesh`.
        amplitude: the shortening, a length: a number, an Amplitude, or a formula of the parameters
            as text.
    """

    section: str
    amplitude: Amplitude | Formula

    def __post_init__(self) -> None:
        check_tag("section", self.section)
        check_amplitude(self, f"the preload of section {self.section!r}", formulas=True)

    def equations(self, assembler: Assembler) -> ConstraintEquations:
        """See :class:`~hhr_dolfinx.plugins.constraints.elimination.Constraint`."""
        section = _Section.of(assembler, self.section)
        values = -np.tile(section.normal, section.above.size)
        return ConstraintEquations(
            section.openings(assembler.size), section.dofs(section.above), values
        )


@dataclass(frozen=True)
class ForcedSection:
    """Both sides of a section move alike, but for a common shortening, which a :class:`BoltForce`
    draws.

    Attributes:
        section: name of the section, see :class:`~hhr_dolfinx.plugins.constraints.cut.CutMesh`.
    """

    section: str
    amplitude: Amplitude = field(default=Amplitude(), init=False)

    def __post_init__(self) -> None:
        check_tag("section", self.section)

    def equations(self, assembler: Assembler) -> ConstraintEquations:
        """See :class:`~hhr_dolfinx.plugins.constraints.elimination.Constraint`.

        The pair in the middle opens along the normal n alone, and all others as it does.
        """
        section = _Section.of(assembler, self.section)
        normal = section.normal
        openings = section.openings(assembler.size)
        middle = slice(normal.size * section.first, normal.size * (section.first + 1))
        along = csr_matrix(np.tile(np.outer(normal, normal), (section.above.size, 1)))
        dofs = section.dofs(section.above)
        equations = ConstraintEquations(
            csr_matrix(openings - along @ openings[middle]), dofs, np.zeros(dofs.size)
        )
        return equations.take(np.arange(dofs.size) != middle.start + np.abs(normal).argmax())


@dataclass(frozen=True)
class BoltForce:
    """Force in a bolt that draws the sides of a :class:`ForcedSection` together, positive as
    tension.

    Attributes:
        section: name of the section.
        amplitude: the force: a number, an Amplitude, or a formula of the parameters as text.
    """

    section: str
    amplitude: Amplitude | Formula

    def __post_init__(self) -> None:
        check_tag("section", self.section)
        check_amplitude(self, f"the force in section {self.section!r}", formulas=True)

    def check_scene(self, scene: Scene) -> None:
        """Check that the section follows the force.

        Raises:
            SceneError: without a section that follows the force.
        """
        if not any(
            isinstance(constraint, ForcedSection) and constraint.section == self.section
            for constraint in scene.constraints
        ):
            raise SceneError(
                f"the BoltForce of section {self.section!r} acts on one pair of nodes, which the "
                f"others of the section must follow: add ForcedSection({self.section!r}) to the "
                f"constraints of scene '{scene.name}'"
            )

    def terms(self, assembler: Assembler) -> list[Term]:
        """One vector: forces on the pair in the middle, which the others follow."""
        section = _Section.of(assembler, self.section)
        middle = slice(section.first, section.first + 1)
        dofs = [section.dofs(nodes[middle]) for nodes in (section.below, section.above)]
        forces = np.zeros(assembler.size)
        forces[np.concatenate(dofs)] = np.append(section.normal, -section.normal)
        return [Term(self.amplitude, csc_matrix(forces[:, None]))]
