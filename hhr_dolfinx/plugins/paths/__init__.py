"""Families of load paths: paths of one kind by a few parameters, to train, to test and to march on."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="paths",
    public={"hhr_dolfinx.plugins.paths.path_families": "Leg NamedPath PathFamily"},
    commands={"march": "hhr_dolfinx.plugins.paths.commands:march"},
)
