"""The command page."""

from shell import invoke

import hhr_dolfinx as hhr


def test_a_hyper_reduced_model_has_no_page(hertz_reduction, tmp_path):
    hhr.save_model(tmp_path / "hhr.npz", hertz_reduction)
    code, said = invoke("page", tmp_path / "hhr.npz")
    assert code == 3 and "condense the scene" in said and "Traceback" not in said
