"""Training where models of what is known are worst, and the indicators that tell where that is."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="greedy",
    public={
        "hhr_dolfinx.plugins.greedy.greedy": "Greedy",
        "hhr_dolfinx.plugins.greedy.indicators": "Eta Eta2 ForceError LargestEstimate",
    },
    trainings={"greedy": "hhr_dolfinx.plugins.greedy.commands:Chosen"},
)
