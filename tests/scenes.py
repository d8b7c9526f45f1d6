"""Small scenes with closed-form answers, and checks every contact solution must pass."""

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block
from hhr_dolfinx.reduction.rid import reduced_domain

THESIS = hhr.Recipe.thesis(1e-8)
"""The recipe of the thesis for the half-discs; built ``as_it_is``, since the trust check warns of it, with reason."""


def node_dofs(problem, nodes):
    """All dofs of the given nodes, (len(nodes) * block_size,)."""
    return (np.asarray(nodes)[:, None] * problem.block_size + np.arange(problem.block_size)).ravel()


def whole_domain(problem):
    """The RID that is the whole domain: plain Galerkin projection with all contact conditions."""
    return reduced_domain(problem, np.arange(len(problem.points)))


def pressed_block(hypothesis, *, young=3.0, poisson=0.3, gap=0.01, cells=4, simplices=False):
    """A block of height 2 pushed by ``push`` in [0, 0.1] on a rigid floor ``gap`` below it.

    Its strain is uniform: the pressure is E (push - gap) / 2, and with E / (1 - nu^2) in plane strain.
    """
    dim = 3 if hypothesis == "solid" else 2
    up = dim - 1
    normal = tuple(-1.0 if axis == up else 0.0 for axis in range(dim))
    fixed = tuple(hhr.Displacement(block.side(axis, upper=False), axis) for axis in range(up))
    push = hhr.Displacement(block.side(up, upper=True), up, hhr.Amplitude(slopes={"push": -1.0}))
    corner = (1.5,) * up + (2.0,)
    return hhr.Scene(
        name=f"pressed_{hypothesis}",
        geometry=lambda comm: block.block(
            comm, lower=(0.0,) * dim, upper=corner, cells=(cells,) * dim, simplices=simplices
        ),
        hypothesis=hypothesis,
        bodies=(hhr.Body(block.SOLID, young, poisson),),
        contacts=(hhr.Obstacle(block.side(up, upper=False), normal, gap),),
        parameters=hhr.ParameterSpace(("push",), (0.0,), (0.1,)),
        displacements=(*fixed, push),
    )


def check_contact_conditions(problem, displacement, forces, mu, relative=1e-10):
    """All of (1.21): equilibrium on free dofs, no penetration, no adhesion, complementarity.

    Round-off in u is about 1e-16 cond(K); 1e-10 leaves room for cond(K) up to 1e6.
    """
    theta = problem.theta(mu)
    homogeneous = displacement - problem.lifts @ theta
    internal = problem.stiffness @ homogeneous
    residual = (internal + problem.contact.T @ forces - problem.loads @ theta)[problem.free]
    slack = problem.gaps @ theta - problem.contact @ homogeneous
    force = np.abs(problem.loads @ theta).max()
    length = max(np.abs(problem.gaps @ theta).max(), np.abs(homogeneous).max())
    assert np.abs(residual).max() <= relative * force
    assert forces.min() >= -relative * force
    assert slack.min() >= -relative * length
    assert np.abs(forces * slack).max() <= relative * force * length
