"""Pictures leave the process as it is."""

import importlib

import pytest
from needs import needs, present
from scenes import pressed_pair

import hhr_dolfinx as hhr

matplotlib = pytest.importorskip("matplotlib")
MODULES = [
    "hhr_dolfinx.plugins.scene_checks.drawing",
    "hhr_dolfinx.plugins.plots.figures",
    "hhr_dolfinx.plugins.studies.plots",
]


@needs("plots")
def test_a_picture_does_not_change_the_backend_of_the_user(tmp_path):
    """A notebook that has chosen another one keeps it, also when the module is loaded first."""
    before = matplotlib.get_backend()
    full = hhr.FullOrderModel(pressed_pair("plane_strain", [(10.0, 0.3), (8.0, 0.3)], cells=2))
    try:
        matplotlib.use("svg")
        for name in MODULES[: 2 + present("studies")]:
            importlib.reload(importlib.import_module(name))
        full.solve([0.03, 0.0, 0.05, 0.005]).plot(tmp_path / "answer.png")
        full.scene.plot(tmp_path / "scene.png")
        assert matplotlib.get_backend() == "svg"
    finally:
        matplotlib.use(before)
    assert {path.name for path in tmp_path.iterdir()} == {"answer.png", "scene.png"}
