"""Local models, thesis chapter 4: several small models, each for a part of the box, used like
one.
"""

from hhr_dolfinx.registry import Plugin, Way

PLUGIN = Plugin(
    name="local_models",
    optional=("one_call",),
    public={
        "hhr_dolfinx.plugins.local_models.models": "LocalModels",
        "hhr_dolfinx.plugins.local_models.clustered": "Clusters",
        "hhr_dolfinx.plugins.local_models.splitting": "Splitting",
    },
    classes={"hhr_dolfinx.plugins.local_models.models": "Choice LocalModels"},
    kinds={"local": "hhr_dolfinx.plugins.local_models.reductor:local"},
    reductors={
        "local": Way(
            "hhr_dolfinx.plugins.local_models.reductor:Local",
            lambda full: (
                full.equilibrium is None
                and not full.law.remembers
                and full.problem.reshaped is None
            ),
        )
    },
)
