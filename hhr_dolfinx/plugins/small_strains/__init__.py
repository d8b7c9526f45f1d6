"""Strains and rotations of answers that are not small: warnings, and refusals where the theory has
no meaning.
"""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="small_strains",
    tools={"small_strains": "hhr_dolfinx.plugins.small_strains.guard:StrainGuard"},
    classes={"hhr_dolfinx.plugins.small_strains.limit": "StrainRange"},
)
