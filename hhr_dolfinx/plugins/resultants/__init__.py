"""Outputs of sums over supports and contacts: reactions, contact area, centre of pressure."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.resultants"
_OUTPUTS = {
    f"{_HERE}.outputs": "CentreOfPressure ContactArea",
    f"{_HERE}.reactions": "Reaction",
}

PLUGIN = Plugin(
    name="resultants",
    public=_OUTPUTS,
    parts={"outputs": _OUTPUTS},
    classes={f"{_HERE}.kinds": "Centre ReactionTerms"},
    switches={f"{_HERE}.switches": "contact_area"},
)
