"""Baselines of other authors, and naive ones, to compare with."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="baselines",
    needs=("studies",),
    parts={"baselines": {"fom_naive": "hhr_dolfinx.plugins.baselines.naive:NaiveFullOrder"}},
)
