"""Greedy training: training points where indicators expect the largest errors, and these
indicators.
"""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="greedy",
    needs=("paths",),
    public={
        "hhr_dolfinx.plugins.greedy.greedy": "Greedy",
        "hhr_dolfinx.plugins.greedy.indicators": "Eta Eta2 ForceError LargestEstimate",
        "hhr_dolfinx.plugins.greedy.lattice": "Lattice",
    },
    parts={"samplings": {"Lattice": "hhr_dolfinx.plugins.greedy.lattice:Lattice"}},
    trainings={"greedy": "hhr_dolfinx.plugins.greedy.commands:ChosenTraining"},
)
