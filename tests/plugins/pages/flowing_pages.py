"""Models of blocks that flow, on pages and in C: made once, and their paths."""

import dataclasses
from functools import cache
from typing import ClassVar

import contract
import numpy as np
import ufl
from condensing import TIGHT, condensed
from mpi4py import MPI
from scenes import lying, pressed_pair, slope, space
from toy_law import Ludwik

import hhr_dolfinx as hhr
from hhr_dolfinx.forms.laws import equivalent, standard, trace
from hhr_dolfinx.geometries import stacked_blocks as blocks
from hhr_dolfinx.geometries import two_blocks

EXACT = hhr.MarchSettings(relative_force=1e-11, iterations=200)
FAR = dataclasses.replace(EXACT, outside="ignore")


@dataclasses.dataclass(frozen=True)
class Fibres(hhr.Law):
    """Plasticity of a matrix with elastic fibres along 0.6 x + 0.8 y: a law that states the
    elasticity, and flows.
    """

    volume: float
    shear: float
    fibre: float
    yield_stress: float
    hardening: float
    unknowns: ClassVar = {"inelastic": 0, "cumulated": 1}
    elastic: ClassVar = True

    def statement(self, at):
        c = at.constants
        along = ufl.as_vector([0.36, 0.64, 0.0, 0.48 * np.sqrt(2.0)])

        def energy(strain, state):
            inside = strain - state["inelastic"]
            stretched = c.volume * trace(inside) ** 2 + c.fibre * ufl.dot(inside, along) ** 2
            return (
                stretched / 2
                + c.shear * ufl.dot(inside, inside)
                + c.hardening * state["cumulated"] ** 2 / 2
            )

        def yields(forces, state):
            return equivalent(forces["inelastic"]) - c.yield_stress + forces["cumulated"]

        return standard(at, energy, yields)


TURNED = (0.8, 0.6, 0.0), (-0.6, 0.8, 0.0), (0.0, 0.0, 1.0)
WOOD = hhr.Orthotropic(9.0, 3.0, 1.5, 0.4, 0.3, 0.2, 1.0, 0.8, 0.3, TURNED)
LAWS = {
    "moduli": (hhr.Plasticity(0.05, 0.2), None),
    "back stresses, creep": (
        hhr.Chaboche("0.03 + 0.01 * x", ((0.5, 20.0),), 0.01, 30.0),
        hhr.Norton("0.2 * E1", 4.0),
    ),
    "cone, heat": (
        hhr.DruckerPrager(0.05, 0.2, 0.1),
        hhr.Heated(hhr.Norton(3.0, 4.0), 0.002, "0.3 * E1 + y"),
    ),
    "wood": (hhr.Plasticity(0.05, 0.2), WOOD),
    "wood, heat": (hhr.Plasticity(0.05, 0.2), hhr.Heated(WOOD, 0.1, "push * (1 + y)")),
    "fibres": (hhr.Plasticity(0.045, 0.2), Fibres(3.0, 2.0, 6.0, 0.07, 0.3)),
    "infinite slope": (Ludwik(0.04, 0.2, 0.4), None),
    "plane stress": (hhr.Voce(0.05, 0.02, 20.0, 0.4), None),
    "graded": (hhr.Voce("0.03 + 0.02 * x", 0.02, 20.0, 0.4), WOOD),
}
"""Laws of both bodies, by a name, and in plane stress, or graded, where that says so."""


def two_bodies(name="moduli"):
    """Two blocks in the plane, pushed together, of which one yields, whose E is a parameter."""
    laws = LAWS[name]
    grading = {"grading": lambda x: 1 + 0.8 * (x[0] - 1) * x[1]} if name == "graded" else {}
    bodies = (
        hhr.Body(two_blocks.FIRST, "E1", 0.3, laws[0], **grading),
        hhr.Body(two_blocks.SECOND, 5.0, 0.35, laws[1], **grading),
    )
    hypothesis = "plane_stress" if name == "plane stress" else "plane_strain"
    base, top = (
        pressed_pair(hypothesis, bodies, {"E1": (2.0, 4.0)}, cells=4),
        two_blocks.side(2, 1, True),
    )
    held = [item for item in base.displacements if not item.amplitude.slopes]
    moved = hhr.Displacement(top, 0), hhr.Displacement(top, 1, slope("push", -1.0))
    given = {"loads": (), "openings": (), "parameters": space(push=(0.0, 0.06), E1=(2.0, 4.0))}
    given["outputs"] = (hhr.ContactForce("force", 0, (0.0, 1.0)),)
    return dataclasses.replace(base, displacements=(*held, *moved), **given)


@cache
def pair(name="moduli"):
    """Full model, condensed flow, histories."""
    full = hhr.FullOrderModel(two_bodies(name))
    histories = [full.march(cycle(young), TIGHT) for young in (2.0, 4.0)]
    return full, condensed(full, histories)


@cache
def yielding():
    """Two blocks of which one yields, with constants that are no parameters, and outputs."""
    training = contract.flowing()
    return training.full_order, training.condense()


@cache
def loose(*, rubs=False):
    """A block that flows and lies on another one, held by contact alone, or by friction.

    Full model, condensed flow.
    """
    made = lying(
        tilt=0.2, cells=(6, 3), sideways=0.15 if rubs else 0.0, parameters=space(p=(0.0, 12.0))
    )
    (pair,) = made.contacts
    outputs = (
        hhr.ContactForce("force", 0, (0.0, 1.0)),
        hhr.DisplacementAt("sunk", (0.5, 2.0), 1, blocks.UPPER_BLOCK),
        hhr.DisplacementAt("moved", (0.0, 2.0), 0, blocks.UPPER_BLOCK),
    )
    made = dataclasses.replace(
        made,
        bodies=tuple(
            dataclasses.replace(body, law=hhr.Plasticity(6.0, 100.0)) for body in made.bodies
        ),
        contacts=(dataclasses.replace(pair, friction=0.4),) if rubs else made.contacts,
        outputs=outputs,
    )
    full = hhr.FullOrderModel(made, MPI.COMM_SELF)
    tight = dataclasses.replace(TIGHT, search="tangent")
    return full, condensed(full, [full.march(pressing(top), tight) for top in (6.0, 7.0, 8.0)])


def pressing(top):
    """Loaded, unloaded, loaded by more, and unloaded again: nodes of the curved side close and
    open.
    """
    shares = (0.0, 0.1, 0.4, 0.8, 0.5, 0.1, 1.0, 0.3)
    return [(float(k), np.array([top * share])) for k, share in enumerate(shares)]


def cycle(young, top=0.05):
    shares = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 0.7, 0.4, 0.1)
    return [(float(k), np.array([top * share, young])) for k, share in enumerate(shares)]
