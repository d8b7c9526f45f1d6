"""Outputs of the stress of bodies: von Mises' stress, elastic energy."""

from hhr_dolfinx.registry import Plugin

_OUTPUTS = {"hhr_dolfinx.plugins.stress.outputs": "ElasticEnergy StressAt VonMises"}

PLUGIN = Plugin(
    name="stress",
    optional=("elasticity",),
    public=_OUTPUTS,
    parts={"outputs": _OUTPUTS},
    classes={
        "hhr_dolfinx.plugins.stress.kinds": (
            "Energy FlowStressValue Mises StoredEnergy StrainedMises StressValue"
        ),
    },
    switches={"hhr_dolfinx.plugins.stress.switches": "energy von_mises"},
)
