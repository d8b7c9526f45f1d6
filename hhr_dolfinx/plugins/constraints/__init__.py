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

PLUGIN = Plugin(
    name="constraints",
    needs=("mortar",),
    public=_PLACES,
    tools={"constraints": "hhr_dolfinx.plugins.constraints.elimination:eliminated"},
    parts={
        "loads": {
            "hhr_dolfinx.plugins.constraints.couplings": "CoupledForce",
            "hhr_dolfinx.plugins.constraints.preload": "BoltForce",
        }
    },
)
