"""Models shared by the tests; the scene is that of the demo."""

import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import hertz_half_discs as demo
import pytest
import slow_suite
from hypothesis import HealthCheck, settings
from needs import present
from no_skips import pytest_make_collect_report, pytest_runtest_makereport  # noqa: F401
from processes import forget_own_folders
from quick_forms import compile_quickly
from scenes import THESIS
from slow_suite import (  # noqa: F401
    keep_slice,
    pytest_addoption,
    pytest_ignore_collect,
)

import hhr_dolfinx as hhr

# options of commands are those of the plug-ins at its first import, and some tests replace these
import hhr_dolfinx.command.making

forget_own_folders()


def pytest_configure(config):
    compile_quickly(config)
    slow_suite.pytest_configure(config)


# nothing depends on the clock of a busy machine
settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")

NEEDING = {
    "core/test_benchmarks.py": ("mortar", "second_order", "studies"),
    "core/test_command.py": ("nonmatching",),
    "core/test_deck_benchmark.py": ("decks", "nonmatching", "studies"),
    "core/test_demo.py": (
        "plots",
        "exporters",
        "moduli",
        "mortar",
        "one_call",
        "pages",
        "studies",
        "theorems",
        "volume_loads",
    ),
    "core/test_fuel_rod.py": ("volume_loads",),
    "plugins/baselines/test_naive.py": ("elasticity",),
    "plugins/local_models/test_subspaces.py": ("theorems",),
    "plugins/contact_heat/test_heated_rod.py": ("studies",),
    "plugins/contact_heat/test_heat_in_c.py": ("exporters",),
    "plugins/contact_heat/test_heat_on_page.py": ("pages",),
    "plugins/theorems/test_dual_basis.py": ("rivals",),
    "core/test_outputs.py": ("stress", "elasticity"),
    "plugins/exact_errors/test_fitted_forces.py": ("paths", "contact_laws"),
    "plugins/exact_errors/test_output_bounds.py": ("stress",),
    "plugins/um_bridge/test_um_bridge.py": ("moduli",),
    "plugins/friction/test_flowing_friction.py": ("inelastic",),
    "plugins/greedy/test_restriction.py": ("mortar",),
    "plugins/exporters/test_deck.py": ("nonmatching",),
    "plugins/inelastic/test_door.py": ("nonmatching",),
    "plugins/inelastic/test_history_files.py": ("nonmatching",),
    "plugins/inelastic/test_history_indicator.py": ("nonmatching",),
    "plugins/inelastic/test_condensed_flow.py": ("volume_loads",),
    "plugins/inelastic/test_condensed_stress.py": ("volume_loads",),
    "plugins/inelastic/test_indentation.py": ("mortar",),
    "plugins/inelastic/test_law_parameters.py": ("volume_loads",),
    "plugins/inelastic/test_varied.py": ("nonmatching", "volume_loads"),
    "plugins/one_call/test_command_reduce.py": ("nonmatching",),
    "plugins/one_call/test_search_limits.py": ("moduli",),
    "plugins/pages/test_flow_pages.py": ("inelastic", "moduli", "volume_loads"),
    "plugins/scene_checks/test_fields.py": ("nonmatching",),
    "plugins/scene_checks/test_thirty_mistakes.py": ("nonmatching",),
    "plugins/conformance/test_compose.py": ("inelastic", "studies"),
    "plugins/constraints/test_constraints_with_laws.py": ("inelastic",),
    "plugins/pages/test_page_shown.py": ("inelastic",),
    "plugins/pages/test_rubbing_pages.py": ("inelastic",),
    "plugins/exporters/test_own_laws.py": ("contact_laws",),
    "plugins/exporters/test_proportional.py": ("contact_laws",),
    "plugins/floating/test_condensed_laws.py": ("inelastic",),
    "plugins/foreign/test_calculix.py": ("decks",),
    "plugins/local_models/test_local_training.py": ("studies",),
    "plugins/stress/test_energy.py": ("inelastic",),
    "plugins/shapes/test_shapes_beside.py": ("constraints", "nodal_loads", "obstacles"),
    "plugins/constraints/test_constraints.py": ("nodal_loads",),
    "plugins/contact_laws/test_flow_slopes.py": ("friction", "inelastic"),
    "plugins/scene_checks/test_mesh_error.py": ("nodal_loads",),
    "plugins/plots/test_contact_fields.py": ("pages",),
    "plugins/pages/test_pages_in_chromium.py": ("conformance", "inelastic", "studies"),
    "plugins/conformance/test_conformance.py": ("stress", "volume_loads"),
    "plugins/floating/test_attack_floating.py": ("exact_errors",),
    "plugins/inelastic/test_condensed_step.py": ("volume_loads",),
    "plugins/inelastic/test_flow_moduli.py": ("volume_loads",),
    "plugins/ranks/test_rows.py": ("nonmatching",),
    "plugins/nonmatching/test_split_interfaces.py": ("shared_nodes",),
    "plugins/volume_loads/test_volume_loads.py": ("elasticity",),
    "plugins/shapes/test_shape_outputs.py": ("mortar", "second_order", "volume_loads"),
    "plugins/studies/test_studies.py": ("nonmatching",),
}
"""Files all of whose scenes need plug-ins, or are of scripts that import them."""
collect_ignore = [file for file, plugins in NEEDING.items() if not present(*plugins)]


@pytest.hookimpl(tryfirst=True)  # before those that are not asked for are left out
def pytest_collection_modifyitems(config, items):
    """Mark the cases of slow_cases.txt as slow.

    Leave out other slices, and tests whose plug-ins are not there.
    """
    lacking = [
        item
        for item in items
        if any(not present(*mark.args) for mark in item.iter_markers("needs"))
    ]
    if lacking:
        config.hook.pytest_deselected(items=lacking)
        items[:] = [item for item in items if item not in lacking]
    lines = (Path(__file__).parent / "slow_cases.txt").read_text().splitlines()
    slow = {line for line in lines if line and not line.startswith("#")}
    for item in items:
        name = item.path.name + item.nodeid[item.nodeid.index("::") :]
        if name in slow or name.partition("[")[0] in slow:
            item.add_marker(pytest.mark.slow)
    keep_slice(config, items)


@pytest.fixture
def restless():
    """Threads change as often as they can, so that a race shows in one run and not in one of a
    thousand.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.fixture(scope="session")
def hertz():
    """Full-order model of the half-discs."""
    return hhr.FullOrderModel(demo.scene())


@pytest.fixture(scope="session")
def hertz_snapshots(hertz):
    """The 31 training points of the thesis."""
    return hhr.compute_snapshots(hertz, hertz.problem.parameters.grid([31]))


@pytest.fixture(scope="session")
def hertz_reduction(hertz, hertz_snapshots):
    """The thesis' recipe, as it is: its forces outside the RID are up to 22 % wrong, which the
    trust check says.
    """
    return hhr.build(hertz, hertz_snapshots, THESIS.as_it_is())
