"""Small sets of local models, made by hand: parts of a box that overlap, and choices between
them.
"""

import dataclasses

import numpy as np
import pellet_cladding as pellet
from mpi4py import MPI
from scenes import pressed_pair

import hhr_dolfinx as hhr
from hhr_dolfinx.linear.dense import LapackLU

AS_IT_IS = hhr.Recipe().as_it_is()
OUTPUTS = (hhr.LargestPressure("peak", 0, unit="MPa"), hhr.ContactForce("force", 0, (0.0, 1.0)))
CUT = 3.3
"""Height h1 of the pellet at which its models change, in mm."""
REACH = (0.0, 0.4)
VARIED = {"E1": (1.0, 6.0)}


def choice(nodes, reach):
    """A choice of rows (axis, cut, low, high) of cuts, and (-1, model) of regions."""
    rows = np.array(
        [(axis, *rest, 0) if axis >= 0 else (-1, 0.0, 0, 0, *rest) for axis, *rest in nodes]
    )
    from hhr_dolfinx.plugins.local_models.models import Choice

    axis, low, high, label = (rows[:, k].astype(np.int64) for k in (0, 2, 3, 4))
    return Choice(axis, rows[:, 1].copy(), low, high, label, np.array(reach, dtype=float))


def one_cut(axis, cut, reach):
    """The first of two models below a cut, the second one above."""
    return choice([(axis, cut, 1, 2), (-1, 0), (-1, 1)], reach)


def pellet_training(grid=(6, 8), outputs=OUTPUTS):
    """The pellet on a coarse mesh, with outputs, and answers on a grid."""
    scene = dataclasses.replace(pellet.scene(**pellet.QUICK_MESH), outputs=outputs)
    return hhr.train(scene, grid, held_out=0, comm=MPI.COMM_SELF)


def parts_of(training, bounds, recipe=AS_IT_IS):
    """A model of the answers inside each pair of bounds of the last parameter."""
    last = training.snapshots.points[:, -1]
    rows = [np.flatnonzero((last >= low) & (last <= high)) for low, high in bounds]
    return [hhr.build(training.full_order, training.snapshots.take(part), recipe) for part in rows]


def pellet_models(training):
    """Two models of the pellet, on heights up to 3.7 and from 2.9 mm."""
    return parts_of(training, [(0.0, 3.7), (2.9, 6.1)])


def three_models(training):
    """Three models of the pellet, cut along both parameters."""
    tree = choice([(1, CUT, 1, 2), (-1, 0), (0, 100.0, 3, 4), (-1, 2), (-1, 1)], (5.0, 0.4))
    return hhr.LocalModels([*pellet_models(training), *parts_of(training, [(2.0, 6.1)])], tree)


def varying_set():
    """Two models of a pair of blocks whose lower modulus is a parameter, and the training."""
    training = hhr.train(
        pressed_pair("plane_strain", (("E1", 0.3), (5.0, 0.3)), VARIED, cells=3), hhr.Sobol(32)
    )
    reach = np.zeros(len(training.full_order.parameters.names))
    reach[-1] = 0.5
    return training, hhr.LocalModels(
        parts_of(training, [(0.0, 4.3), (2.7, 9.0)]), one_cut(4, 3.5, reach)
    )


def by_lapack(model):
    """A model as a file holds it: factored by LAPACK, which differs from PETSc in last digits."""
    if not isinstance(model, hhr.ReducedModel):
        return model.changed(models=tuple(by_lapack(part) for part in model.models))
    return model.changed(factorise=LapackLU)


def bits(answer):
    """What an answer hands out, to the last digit."""
    parts = (
        answer.parameter,
        answer.unknown,
        answer.multipliers,
        answer.displacement(),
        answer.forces(),
    )
    return b"".join(part.tobytes() for part in parts)


def random_choice(dice, parameters=3, cuts=8, models=4, reach=0.0):
    """A random tree of cuts through the unit box, each inside of the region that it divides."""
    nodes, regions = [[]], [(0, np.zeros(parameters), np.ones(parameters))]
    for _ in range(cuts):
        node, least, most = regions.pop(dice.integers(len(regions)))
        axis = dice.integers(parameters)
        cut = dice.uniform(least[axis], most[axis])
        below, above = most.copy(), least.copy()
        below[axis] = above[axis] = cut
        regions += [(len(nodes), least, below), (len(nodes) + 1, above, most)]
        nodes[node] = (axis, cut, len(nodes), len(nodes) + 1)
        nodes += [[], []]
    rows = [node or (-1, dice.integers(models)) for node in nodes]
    return choice(rows, np.full(parameters, reach))
