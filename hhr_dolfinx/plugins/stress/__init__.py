"""Outputs of the stress of bodies: von Mises' stress, elastic energy."""

from hhr_dolfinx.registry import Plugin

_OUTPUTS = "hhr_dolfinx.plugins.stress.outputs"

PLUGIN = Plugin(
    name="stress",
    public={_OUTPUTS: "ElasticEnergy VonMises"},
    parts={"outputs": {name: f"{_OUTPUTS}:{name}" for name in ("ElasticEnergy", "VonMises")}},
    classes={"hhr_dolfinx.plugins.stress.kinds": "Energy Mises"},
)
