"""Conformance: checks that a user-defined part fulfils the contract of its seam."""

from hhr_dolfinx.registry import Plugin

_CHECKS = (
    "check_contact_law check_load check_output check_pairing check_reductor check_system "
    "pressed_blocks"
)

_SWITCHES = (
    "axisymmetric field_of_motion graded obstacle opening own_elasticity plane_stress poisson "
    "simplices solid traction young"
)

PLUGIN = Plugin(
    name="conformance",
    optional=("contact_laws", "exporters"),
    parts={"checks": {"hhr_dolfinx.plugins.conformance.checks": _CHECKS}},
    switches={"hhr_dolfinx.plugins.conformance.switches": _SWITCHES},
)
