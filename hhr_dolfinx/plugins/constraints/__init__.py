"""Ties, couplings and equations: displacements that follow others."""

from hhr_dolfinx.registry import Plugin

_PLACES = {
    "hhr_dolfinx.plugins.constraints.equations": "Equation Periodic",
    "hhr_dolfinx.plugins.constraints.couplings": "CoupledForce MeanMotion RigidMotion",
    "hhr_dolfinx.plugins.constraints.cut": "CutMesh",
    "hhr_dolfinx.plugins.constraints.directed": "DirectedDisplacement",
    "hhr_dolfinx.plugins.constraints.preload": "BoltForce ForcedSection Preload",
    "hhr_dolfinx.plugins.constraints.serendipity": "Serendipity",
    "hhr_dolfinx.plugins.constraints.tie": "Tie",
}

_SWITCHES = (
    "bolt_force coupled_force directed equation mean_motion periodic preload rigid_motion "
    "serendipity tie"
)  # fmt: skip

PLUGIN = Plugin(
    name="constraints",
    needs=("mortar",),
    public=_PLACES,
    tools={
        "constraints": "hhr_dolfinx.plugins.constraints.elimination:eliminated",
        "joined_bodies": "hhr_dolfinx.plugins.constraints.bodies:joined_bodies",
    },
    parts={
        "loads": {
            "hhr_dolfinx.plugins.constraints.couplings": "CoupledForce",
            "hhr_dolfinx.plugins.constraints.preload": "BoltForce",
        }
    },
    switches={"hhr_dolfinx.plugins.constraints.switches": _SWITCHES},
)
