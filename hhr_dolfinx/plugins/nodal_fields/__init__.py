"""Fields at nodes that other programs compute, as loads and as parameters."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.nodal_fields"

PLUGIN = Plugin(
    name="nodal_fields",
    needs=("volume_loads",),
    public={f"{_HERE}.field": "NodalField", f"{_HERE}.modes": "FieldModes"},
)
