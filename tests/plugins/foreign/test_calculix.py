"""CalculiX itself: its K of elements that we lack, beside its own contact, and the command that
reads its deck.
"""

import runpy
import shutil
import subprocess
from pathlib import Path

import foreign_decks as decks
import pytest
import shell_plate
from click.testing import CliRunner

import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.decks.commands import start

with_calculix = pytest.mark.skipif(
    shutil.which("ccx") is None, reason="ccx, CalculiX, is not installed"
)


@with_calculix
@pytest.mark.parametrize(
    "kind", ["B31", "S8R", "C3D6", "C3D15", "C3D8I", "C3D20R", "mixed", "S4", "B32"]
)
def test_elements_that_we_lack_press_as_in_calculix(kind, tmp_path):
    """Within 0.2 %: 1.5e-5 seen.

    Sections of beams, both sides of shells, incompatible modes without nodes.
    """
    row = decks.of_calculix(kind, tmp_path)
    assert row["outcome"] == "right", row
    assert abs(row["ours"] / row["theirs"] - 1) <= 1e-4


@with_calculix
@pytest.mark.slow
def test_parts_of_two_codes_press_as_in_calculix(tmp_path):
    """Shells by the K of CalculiX on a solid by a file in the format of Nastran: within 0.2 %, by
    its penalty, 3.4e-4 seen. On a rigid solid the force would be 2 % larger.
    """
    row = decks.of_two_codes(tmp_path)
    assert row["outcome"] == "right", row


@with_calculix
def test_the_superelement_of_calculix_is_refused(tmp_path):
    """Version 2.20 writes the block of K of the retained dofs as it is.

    a later one may write it condensed.
    """
    part = decks.block("C3D8", (4, 2, 2))
    retained = "*STEP\n*SUBSTRUCTURE GENERATE\n*RETAINED NODAL DOFS,SORTED=NO\nBOT,3,3\nTIP,3,3\n"
    output = "*SUBSTRUCTURE MATRIX OUTPUT,STIFFNESS=YES,OUTPUT FILE=USER DEFINED,FILE NAME=sub\n"
    output += "*END STEP\n"
    (tmp_path / "sub.inp").write_text(part.model + part.supports + retained + output)
    decks.run(tmp_path, "sub")
    if "2.20" not in subprocess.run(["ccx", "-v"], capture_output=True, text=True).stdout:
        return
    with pytest.raises(hhr.errors.SceneError, match="was not condensed"):
        hhr.read_stiffness(tmp_path / "sub.mtx")


def test_start_writes_the_scene(tmp_path):
    """From the deck with contact, the K and the case: the force of CalculiX at the push of the
    deck.
    """
    folder = shell_plate.unpacked(tmp_path)
    words = [
        folder / "plate.inp",
        "--stiffness",
        folder / "plate.sti",
        "--case",
        folder / "case.inp",
    ]
    said = CliRunner().invoke(start, [*map(str, words), "--to", str(folder / "plate.py")])
    assert said.exit_code == 0, said.output
    scene = runpy.run_path(str(folder / "plate.py"))["scene"]
    (push, force) = shell_plate.theirs(folder)[2]
    assert scene.parameters.middle.tolist() == pytest.approx([push], rel=1e-6)
    found = hhr.FullOrderModel(scene).outputs(scene.parameters.middle)["force 0 z"]
    assert found == pytest.approx(force, rel=1e-4)


def test_start_wants_a_case(tmp_path):
    folder = shell_plate.unpacked(tmp_path)
    words = [str(folder / "plate.inp"), "--stiffness", str(folder / "plate.sti")]
    said = CliRunner().invoke(start, words)
    assert said.exit_code != 0 and "needs --case" in said.output
    said = CliRunner().invoke(start, [*words, "--unchecked", "--to", str(folder / "free.py")])
    assert "needs --case" not in said.output


def test_the_table_of_a_case(tmp_path):
    """The same case as a table, with the digits of the results."""
    from hhr_dolfinx.plugins.foreign.case import read_case

    folder = shell_plate.unpacked(tmp_path)
    known = read_case(folder / "case.inp")
    labels = sorted(known.displacements)[::7]
    rows = ["node,fx,fy,fz,ux,uy,uz,held"]
    rows += [f"{node},{','.join(map(repr, force))},,,," for node, force in known.forces.items()]
    rows += [f"{node},,,,{','.join(map(repr, known.displacements[node]))}," for node in labels]
    (folder / "case.csv").write_text("\n".join(rows))
    found = read_case(Path(folder / "case.csv"))
    assert found.forces == known.forces and len(found.displacements) == len(labels)
    scene = shell_plate.scene(shell_plate.block(folder, case=folder / "case.csv"))
    assert hhr.FullOrderModel(scene).conditions == 60
