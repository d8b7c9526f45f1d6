"""A package of a user's own, which hhr_dolfinx knows by its entry points alone."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="contact_toys",
    needs=("pages",),
    public={"contact_toys.laws": "Newtonian"},
    parts={"pairings": {"Slope": "contact_toys.parts:Ramp"}},
    classes={"contact_toys.parts": "Ramp"},
    commands={"slabs": "contact_toys.extras:slabs"},
    companions=("contact_toys.extras:write_note",),
)
