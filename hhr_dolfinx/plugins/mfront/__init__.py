"""Laws of bodies from libraries that MFront compiles."""

from hhr_dolfinx.registry import Plugin

_LAW = {"MFront": "hhr_dolfinx.plugins.mfront.law:MFront"}

PLUGIN = Plugin(name="mfront", needs=("inelastic",), public=_LAW, parts={"laws": _LAW})
