"""The commands embed and export."""

import contract
from shell import AT, DEMO, invoke

import hhr_dolfinx as hhr


def test_a_condensed_model_beside_a_refused_one_is_named(tmp_path):
    hhr.save_model(tmp_path / "model.npz", contract.training("constant").build(contract.AS_IT_IS))
    for words in (("page", tmp_path / "model.npz"), ("embed", tmp_path / "model.npz", "--out", tmp_path / "m.h")):
        code, said = invoke(*words)
        assert code == 3 and "condensed.npz" not in said
    hhr.save_model(tmp_path / "condensed.npz", hhr.condense(contract.blocks()))
    code, said = invoke("embed", tmp_path / "model.npz", "--out", tmp_path / "m.h")
    assert code == 3 and str(tmp_path / "condensed.npz") in said.replace("\n", "")


def test_a_deck_is_written(tmp_path):
    (tmp_path / "closed.py").write_text(
        "from dataclasses import replace\nimport hhr_dolfinx as hhr\nimport your_scene\n"
        "box = hhr.ParameterSpace(('travel',), (0.05,), (1.0,))\n"
        "scene = replace(your_scene.scene(), openings=(), parameters=box)\n"
    )
    path = tmp_path / "decks" / "closed.inp"
    code, output = invoke("export", tmp_path / "closed.py", "--at", "travel=0.5", "--out", path)
    assert code == 0 and output == f"{path}\n"
    deck = path.read_text().upper()
    assert all(word in deck for word in ("*NODE", "*ELEMENT", "*CONTACT PAIR", "*BOUNDARY", "*STEP"))
    code, output = invoke("export", DEMO, *AT, "--out", path)
    assert code == 3 and "gaps are added" in output
