"""Solved cases that are compared by the factors of the full model, which are made anyway."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

import numpy as np

from hhr_dolfinx.errors import NotSolvableError
from hhr_dolfinx.full_order.still import StillMesh
from hhr_dolfinx.plugins.foreign.case import check_definite, compare_displacements, supported

if TYPE_CHECKING:
    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.contact.stiffness import SparseStiffness
    from hhr_dolfinx.full_order.system import System
    from hhr_dolfinx.linear.sparse import FreeCholesky
    from hhr_dolfinx.plugins.foreign.parts import Parts


def same_supports(parts: Parts, free: np.ndarray) -> bool:
    """True if each solved case leaves the dofs of its block free that a scene leaves free.

    Args:
        parts: the blocks.
        free: free dofs of the scene, (3 n,) bool.

    Raises:
        SceneError: for a case with forces on dofs that K lacks.
    """
    for first, block in zip(parts.firsts, parts.blocks, strict=False):
        placed, case = block.read
        if case is None:
            continue
        _, of_case, means = supported(placed, case, block.name)
        of_scene = free[3 * first : 3 * first + of_case.size]
        if means.shape[0] or not np.array_equal(of_case, of_scene):
            return False
    return True


class ComparedByFactors(StillMesh):
    """System of blocks whose cases have the supports of the scene.

    Args:
        parts: the blocks.
        factors: factor of the K of each block in the middle of the box.
    """

    def __init__(self, parts: Parts, factors: Sequence[float]):
        self._parts = parts
        self._factors = factors

    def read(
        self, system: System, problem: ContactProblem
    ) -> tuple[ContactProblem, SparseStiffness]:
        """See :class:`StillMesh`; the solved cases are compared.

        Args:
            system: the system of the problem.
            problem: the contact problem.

        Raises:
            SceneError: for a block whose case differs.
            NotSolvableError: if K is singular.
        """
        problem, stiffness = super().read(system, problem)
        if problem.kernel is not None or problem.on_rows is not None:  # other factors than of K
            self._parts.compare()
            return problem, stiffness
        try:
            self._compare(stiffness)
        except NotSolvableError:
            self._parts.compare()  # says which block is singular
            raise
        with stiffness.held() as factors:
            check_definite(cast("FreeCholesky", factors).negative, "the scene")
        return problem, stiffness

    def _compare(self, stiffness: SparseStiffness) -> None:
        """Compare each block: K is that of all blocks, which are coupled by contact alone."""
        parts = self._parts
        for number, block in enumerate(parts.blocks):
            placed, case = block.read
            if case is None:
                continue
            span = slice(3 * parts.firsts[number], 3 * parts.firsts[number + 1])
            forces = np.zeros(3 * len(parts.points))
            forces[span] = supported(placed, case, block.name)[0]
            solution = self._factors[number] * stiffness.solve(forces)[span]
            compare_displacements(placed, case, block.name, solution)
