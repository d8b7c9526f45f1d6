"""Local models, thesis chapter 4: several small models, each for a part of the box, used like one."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="local",
    public={
        "hhr_dolfinx.plugins.local.models": "LocalModels",
        "hhr_dolfinx.plugins.local.clustered": "Clusters",
        "hhr_dolfinx.plugins.local.splitting": "Splitting",
    },
    classes={"hhr_dolfinx.plugins.local.models": "Choice LocalModels"},
    kinds={"local": "hhr_dolfinx.plugins.local.training:local"},
)
