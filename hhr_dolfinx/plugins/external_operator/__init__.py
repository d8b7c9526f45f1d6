"""Laws of bodies from functions of arrays, which are called as by dolfinx-external-operator."""

from hhr_dolfinx.registry import Plugin

_LAW = {"ExternalOperator": "hhr_dolfinx.plugins.external_operator.law:ExternalOperator"}

PLUGIN = Plugin(
    name="external_operator",
    needs=("inelastic",),
    public=_LAW,
    parts={"laws": _LAW},
    switches={"hhr_dolfinx.plugins.external_operator.switches": "external_law"},
)
