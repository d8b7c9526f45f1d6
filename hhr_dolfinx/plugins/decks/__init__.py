"""Scenes from decks: the command ``hhr start``, for CalculiX, Abaqus, code_aster, and meshes
without physics.
"""

from hhr_dolfinx.registry import Plugin

_LOADS = "hhr_dolfinx.plugins.decks.nodal_forces"
_MESH = "hhr_dolfinx.plugins.decks.with_outside"
_FIELD = "hhr_dolfinx.plugins.decks.temperatures"

PLUGIN = Plugin(
    name="decks",
    needs=(
        "nodal_loads",
        "mortar",
        "friction",
        "soft_contact",
        "inelastic",
        "volume_loads",
        "scene_checks",
        "constraints",
        "obstacles",
        "second_order",
    ),
    public={_LOADS: "NodalForces", _MESH: "WithOutside", _FIELD: "DeckTemperatures"},
    parts={
        "loads": {_LOADS: "NodalForces"},
        "geometries": {_MESH: "WithOutside"},
    },
    commands={"start": "hhr_dolfinx.plugins.decks.commands:start"},
)
