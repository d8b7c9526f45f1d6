"""A system of your own, and the manifest by which scenes find it."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.full_order.system import SummedSystem
from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(name="my_system", needs=("systems",), public={"my_system": "MySystem"})


@dataclass(frozen=True)
class MySystem:
    """K of the bodies and of a foundation, whose stiffness per volume is a parameter.

    Attributes:
        parameter: name of the parameter.
    """

    parameter: str

    def __call__(self, problem, middle, made):
        """The system, of local rows of matrices; see hhr_dolfinx.full_order.system.System."""
        names = problem.parameters.names
        # TODO: your matrices of all dofs, without constraints and springs, and their weights
        foundation = Modulus(self.parameter, "1", names), in_pattern(problem, problem.mass)
        # K of the bodies, which is a sum too if their moduli are parameters
        constant = (Modulus("1", "1", names),), (problem.own_stiffness,)
        moduli, terms = (problem.moduli, problem.stiffness_terms) if problem.moduli else constant
        weights, parts = (*moduli, foundation[0]), (*terms, foundation[1])
        pulls = tuple(problem.stacked(csr_matrix(part @ problem.lifts)) for part in parts)
        summed = replace(problem, moduli=weights, stiffness_terms=parts, pulls=pulls)
        return SummedSystem(summed, middle, made)


def in_pattern(problem, matrix):
    """Local rows of a matrix, (own, N), in the pattern of K of the bodies.

    Raises:
        SceneError: for entries between dofs that no cell joins, which K cannot hold.
    """
    own = problem.own_stiffness
    rows = np.repeat(np.arange(own.shape[0]), np.diff(own.indptr))
    given = csr_matrix(matrix)
    entries = np.asarray(given[rows, own.indices]).ravel()
    if np.count_nonzero(entries) < given.count_nonzero():
        raise SceneError("a matrix couples dofs that no cell of the mesh joins")
    return csr_matrix((entries, own.indices, own.indptr), shape=own.shape)
