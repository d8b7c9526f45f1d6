"""What a store of snapshots needs of a problem, without a mesh: light to import for processes that
are killed.
"""

import csv
import io
import json
import mmap
import pickle

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx import files
from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.contact.prolongation import Prolongation
from hhr_dolfinx.models.answer import Answer, ElasticFields
from hhr_dolfinx.parameters import ParameterSpace


def read_csv(path):
    """Rows of a table by the names of its columns."""
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def bare_problem(dofs=6, conditions=2):
    """A contact problem as far as a store looks at it.

    There is no stiffness, no load and no contact: all solve it.
    """
    return ContactProblem(
        stiffness_terms=(csr_matrix((dofs, dofs)),),
        node_mass=csr_matrix((1, 1)),
        prolongation=Prolongation.of_free(np.ones(dofs, bool), csc_matrix((dofs, 1))),
        forces=csc_matrix((dofs, 1)),
        pulls=(),
        contact=csr_matrix((conditions, dofs)),
        gaps=np.ones((conditions, 1)),
        contact_slaves=np.arange(2),
        contact_pairs=np.zeros(conditions, int),
        contact_points=np.zeros((2, 2)),
        contact_areas=np.ones(2),
        cell_nodes=np.zeros((1, 3), int),
        points=np.zeros((1, 2)),
        amplitudes=Amplitudes(np.ones(1), np.zeros((1, 2))),
        parameters=ParameterSpace(("a", "b"), (0.0, 0.0), (1.0, 10.0)),
    )


class BareFull(ElasticFields):
    """A full model as far as a store looks at it."""

    equilibrium = None

    def __init__(self, problem=None, **sizes):
        self.problem = bare_problem(**sizes) if problem is None else problem

    def displacement(self, answer):
        return answer.unknown


def answer(point, dofs=6, conditions=2, seed=0):
    random_numbers = np.random.default_rng(seed)
    active = random_numbers.random(conditions) < 0.5
    values = random_numbers.random(dofs), random_numbers.random(conditions)
    return Answer(np.array(point, dtype=float), *values, active, 3, Status.CONVERGED, False, None)


def rewrite_signed(path, change):
    """Change header and arrays of a file and give it a valid checksum."""
    with np.load(path) as file:
        arrays = dict(file)
    header = json.loads(arrays.pop("header").item())
    del header["sha256"]
    change(header, arrays)
    arrays = {name: array.copy(order="A") for name, array in arrays.items()}
    header["sha256"] = files._checksum(header, arrays)
    with open(path, "wb") as file:
        np.savez(file, header=np.array(json.dumps(header)), **arrays)


def on_disk(array):
    """Whether an array lies in a file and not in memory of its own."""
    while isinstance(array, np.ndarray):
        array = array.base
    return isinstance(array, mmap.mmap)


class _Arrays(pickle.Pickler):
    """Notes arrays as it meets them."""

    def reducer_override(self, value):
        if isinstance(value, np.ndarray):
            self.found.append(value)
        return NotImplemented


def arrays_of(model):
    """All arrays that a copy of a model would hold."""
    pickler = _Arrays(io.BytesIO())
    pickler.found = []
    pickler.dump(model)
    return pickler.found
