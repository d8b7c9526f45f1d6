"""Contacts that share nodes: a condition that several of them state is one, with the sum of their
areas.
"""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="shared_nodes",
    tools={"shared_nodes": "hhr_dolfinx.plugins.shared_nodes.common_conditions:joined"},
)
