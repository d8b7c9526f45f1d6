"""Programs whose numbers are printed by ranks, and compared."""

import json

import numpy as np
import pytest
from mpirun import launch
from processes import SCENE_FOLDERS

HEAD = """
import dataclasses, json, sys, warnings, weakref
sys.path[:0] = {folders!r}
from needs import present
import numpy as np
import contact_patch_test as patch
import hertz_half_discs as demo
import scale
import sphere_on_block
from mpi4py import MPI
from scenes import pressed_block
from scipy.sparse import csc_matrix
import hhr_dolfinx as hhr
from hhr_dolfinx.certify.compare import compare_points
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.models import full as limits
from hhr_dolfinx.linear import factors, sparse
out, pairing = {{}}, hhr.Mortar if present("mortar") else hhr.NodeToSurface
def note(name, answer):
    out[f"{{name}}, forces"] = answer.forces().tolist()
    out[f"{{name}}, norm"] = float(np.linalg.norm(answer.displacement()))
comm = MPI.COMM_WORLD

def said(action):
    try:
        action()
    except HHRError as error:
        return f"{{type(error).__name__}}: {{error}}"
    return "nothing"

"""
SHOWN = """
if comm.rank == 0:
    print(json.dumps(out))
"""


def numbers_of_ranks(folder, *parts):
    """What 1, 2 and 3 ranks print for parts of one program, which may keep files in a folder."""
    program = "".join((HEAD, *parts, SHOWN)).format(folders=SCENE_FOLDERS, folder=folder)
    return {
        ranks: json.loads(launch(ranks, ["-c", program]).splitlines()[-1]) for ranks in (1, 2, 3)
    }


def assert_same(serial, parallel, but=()):
    """Numbers of ranks are those of one to 1e-10, since factorisations order their sums
    differently.
    """
    assert parallel.keys() == serial.keys()
    for name in serial.keys() - set(but):
        value = serial[name]
        size = np.max(np.abs(value))
        assert parallel[name] == pytest.approx(value, rel=1e-10, abs=1e-10 * size), name
