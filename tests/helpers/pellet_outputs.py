"""The pellet in its cladding on a small mesh, with an output of each kind."""

import dataclasses

import pellet_cladding as demo
import ufl
from needs import present

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import pellet_cladding as geometry


def mean_radial(assembler):
    """Radial displacement integrated over the pellet."""
    radius = ufl.SpatialCoordinate(assembler.dx(geometry.PELLET).ufl_domain())[0]
    return 2 * ufl.pi * radius * assembler.test[0] * assembler.dx(geometry.PELLET)


STRESSES = ()
if present("stress"):
    STRESSES = (
        hhr.VonMises("largest", geometry.CLADDING),
        hhr.VonMises("mean", geometry.PELLET, "mean"),
        hhr.VonMises("below", geometry.PELLET, "max", ((0.0, 0.0), (2.0, 3.0))),
        hhr.ElasticEnergy("energy"),
    )
OUTPUTS = (
    hhr.LargestPressure("peak", 0, unit="MPa"),
    hhr.ContactForce("radial", 0, (1.0, 0.0), unit="N"),
    hhr.ContactForce("lift", 1, (0.0, 2.0)),
    *((hhr.Torque("torque", 0, 0.3, unit="N mm"),) if present("friction") else ()),
    hhr.ContactWidth("area", 0),
    hhr.LostContact("lost", 0),
    hhr.GapAt("gap", 0, (4.1, 6.9)),
    hhr.DisplacementAt("u_r", (4.7, 3.05), 0, unit="mm"),
    *STRESSES,
    hhr.LinearForm("swelling", mean_radial),
)


def small_pellet(**changes):
    """The pellet on a small mesh, with outputs."""
    return dataclasses.replace(demo.scene(**demo.QUICK_MESH), **({"outputs": OUTPUTS} | changes))
