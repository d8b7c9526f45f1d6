"""Scenes from decks: the command ``hhr start``, for CalculiX, Abaqus, code_aster, and meshes without physics."""

from hhr_dolfinx.registry import Plugin

_LOADS = "hhr_dolfinx.plugins.decks.nodal_forces"

PLUGIN = Plugin(
    name="decks",
    needs=("places", "mortar", "friction", "inelastic", "volume_loads", "checks"),
    public={_LOADS: "NodalForces"},
    parts={"loads": {"NodalForces": f"{_LOADS}:NodalForces"}},
    commands={"start": "hhr_dolfinx.plugins.decks.commands:start"},
)
