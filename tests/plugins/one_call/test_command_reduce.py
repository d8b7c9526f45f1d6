"""The command reduce, and a page of what it found."""

from needs import needs
from shell import DEMO, invoke


@needs("pages")
def test_a_model_as_exact_as_wished_and_its_page(tmp_path):
    """One command finds a model, another one makes a page of it, and nothing but the folder is
    between them.
    """
    folder = tmp_path / "found"
    code, said = invoke(
        "reduce", DEMO, "--error", "1%", "--of", "pressure", "--of", "displacement", "--out", folder
    )
    assert (
        code == 0
        and "-> " in said
        and "is met" in said
        and f"model: {folder / 'model.npz'}" in said
    ), said
    assert {path.name for path in folder.iterdir()} >= {
        "model.npz",
        "reduction.json",
        "scenery.npz",
    }
    code, said = invoke("page", folder / "model.npz")
    assert code == 0 and said.strip() == str(folder / "model.html")
    assert "leaf spring" in (folder / "model.html").read_text(encoding="utf-8")
    code, said = invoke(
        "page", folder / "model.npz", "--scene", DEMO, "--out", tmp_path / "other.html"
    )
    assert code == 0 and (tmp_path / "other.html").exists()
    (folder / "scenery.npz").unlink()
    code, said = invoke("page", folder / "model.npz", "--out", tmp_path / "third.html")
    assert code == 3 and "name its scene, --scene" in said
    assert not (tmp_path / "third.html").exists()


def test_a_wish_that_is_not_met_is_an_exit_code(tmp_path):
    code, said = invoke("reduce", DEMO, "--seconds", "1e-9", "--out", tmp_path / "found")
    assert code == 3 and "are over" in said
    for words, why in (
        ("--error much", "is no error"),
        ("--error 0", "must lie in"),
        ("--of love", "no error"),
    ):
        code, said = invoke("reduce", DEMO, *words.split(), "--out", tmp_path / "found")
        assert code in (2, 3) and why in said, said
