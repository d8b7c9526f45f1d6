"""Their elements, our contact: the stiffness of any other finite element code as the system of a
scene.
"""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.foreign"

PLUGIN = Plugin(
    name="foreign",
    needs=("elasticity", "nodal_loads", "tables"),
    public={
        f"{_HERE}.stiffness": "ForeignStiffness",
        f"{_HERE}.block": "ForeignBlock",
        f"{_HERE}.case": "SolvedCase",
        f"{_HERE}.nodes": "ForeignNodes",
        f"{_HERE}.matrix": "ForeignMatrix",
        f"{_HERE}.readers": "read_stiffness",
        f"{_HERE}.outputs": "UncheckedStiffness",
        f"{_HERE}.ground": "NodesToGround",
        f"{_HERE}.loads": "ForeignLoad",
        f"{_HERE}.export": "blocks_of_scene",
    },
    parts={
        "outputs": {f"{_HERE}.outputs": "UncheckedStiffness"},
        "loads": {f"{_HERE}.loads": "ForeignLoad"},
        "pairings": {f"{_HERE}.ground": "NodesToGround"},
    },
    switches={f"{_HERE}.switches": "foreign"},
    tools={"foreign_scene": f"{_HERE}.start:write_scene"},
)
