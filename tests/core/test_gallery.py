"""The gallery of the site, and the pictures of the documents: each is what its command makes."""

import re
import struct
import sys
from pathlib import Path

import pytest
from needs import needs

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
sys.path += [str(ROOT / "scripts"), str(DOCS)]

import pictures  # noqa: E402
from gallery_order import GALLERY, place  # noqa: E402

TABLE = pictures.read_table()
STALE = pictures.stale(TABLE)
DEMO = '''"""{words}"""

# why
SIZE = {size}


def scene(cells=10):
    """{words}"""
    return [SIZE, f"{{cells}} cells"]
'''


def description(name):
    """Title, its underline and blocks of the docstring of a demo."""
    text = (ROOT / "demos" / f"{name}.py").read_text()
    first, *blocks = re.match(r'"""(.*?)"""', text, re.DOTALL)[1].strip().split("\n\n")
    return *first.split("\n"), blocks


@pytest.mark.parametrize("name", GALLERY)
def test_a_demo_of_the_gallery_has_a_title_three_paragraphs_and_a_picture(name):
    title, line, blocks = description(name)
    assert len(title) < 70 and set(line) == {"="} and len(line) == len(title)
    paragraphs = [block for block in blocks if not block.startswith(("..", " "))]
    assert len(paragraphs) == 3
    assert all(150 < len(paragraph) < 700 for paragraph in paragraphs)  # short, and no stub
    shown = re.findall(r"^\.\. image:: /(\S+)\n   :alt: \S", "\n".join(blocks), re.MULTILINE)
    text = (ROOT / "demos" / f"{name}.py").read_text()
    (thumbnail,) = re.findall(r'^# sphinx_gallery_thumbnail_path = "(\S+)"$', text, re.MULTILINE)
    assert shown[0] == thumbnail
    for file in shown:
        assert (DOCS / file).exists()
        assert f"demos/{name}.py" in pictures.PICTURES[file].sources


def test_the_gallery_has_ten_demos_in_an_order():
    assert len(set(GALLERY)) == 10
    assert [place(f"{name}.py") for name in GALLERY] == list(range(10))
    assert place("calibrate.py") == 10


@needs("pages", "plots", "studies")
@pytest.mark.parametrize("file", pictures.PICTURES)
def test_no_picture_is_stale(file):
    assert file not in STALE, STALE[file]


def test_every_picture_of_the_documents_has_a_command():
    made = {"demos", "gallery"}  # folders that a build of the site writes
    files = {str(path.relative_to(DOCS)) for path in DOCS.rglob("*.png")}
    files = {file for file in files if Path(file).parts[0] not in made}
    assert files == set(pictures.PICTURES) == set(TABLE)
    for file, picture in pictures.PICTURES.items():
        assert TABLE[file]["command"] == picture.command
        assert "missing" not in TABLE[file]["sources"].values()


@pytest.mark.parametrize("file", pictures.PICTURES)
def test_pictures_are_fine_enough_for_a_dense_screen(file):
    """Twice the 700 pixels of a column of text, at least."""
    width, height = struct.unpack(">II", (DOCS / file).read_bytes()[16:24])
    assert width >= 1400 and height >= 600


def folder_with(tmp_path, monkeypatch, **values):
    """A checkout of one demo and its picture, which was made with size 3."""
    (tmp_path / "demos").mkdir(exist_ok=True)
    (tmp_path / "demos/toy.py").write_text(DEMO.format(**{"words": "Toy.", "size": 3} | values))
    (tmp_path / "toy.png").write_bytes(b"picture")
    toy = pictures.Picture(("of_answer", "toy"), ("demos/toy.py",))
    monkeypatch.setattr(pictures, "PICTURES", {"toy.png": toy})


def stale_in(tmp_path, table):
    return pictures.stale(table, docs=tmp_path, root=tmp_path)


@pytest.fixture
def made(tmp_path, monkeypatch):
    """The row of that picture."""
    folder_with(tmp_path, monkeypatch)
    digests = {"demos/toy.py": pictures.digest("demos/toy.py", tmp_path)}
    picture = pictures.digest_of_file(tmp_path / "toy.png")
    return {"toy.png": {"sources": digests, "picture": picture}}


def test_a_picture_whose_demo_changed_is_named(tmp_path, monkeypatch, made):
    folder_with(tmp_path, monkeypatch, size=4)
    said = "docs/toy.png is stale: demos/toy.py has changed since it was made; "
    assert stale_in(tmp_path, made) == {"toy.png": said + 'run: make pictures ONLY="toy"'}


def test_words_comments_and_lines_of_a_demo_leave_its_picture(tmp_path, monkeypatch, made):
    folder_with(tmp_path, monkeypatch, words="Other words.")
    path = tmp_path / "demos/toy.py"
    path.write_text(
        path.read_text().replace("# why", "# because").replace("(cells=10)", "(\n    cells=10,\n)")
    )
    assert stale_in(tmp_path, made) == {}


def test_a_picture_that_was_drawn_over_or_lost_is_named(tmp_path, made):
    (tmp_path / "toy.png").write_bytes(b"by hand")
    assert "is not the picture that its command made" in stale_in(tmp_path, made)["toy.png"]
    (tmp_path / "toy.png").unlink()
    assert "was never made" in stale_in(tmp_path, made)["toy.png"]
    assert "was never made" in stale_in(tmp_path, {})["toy.png"]


def test_one_function_of_a_file_is_a_source(tmp_path, monkeypatch):
    folder_with(tmp_path, monkeypatch)
    before = pictures.digest("demos/toy.py::scene", tmp_path)
    folder_with(tmp_path, monkeypatch, size=4)  # outside of the function
    assert pictures.digest("demos/toy.py::scene", tmp_path) == before
    assert pictures.digest("demos/toy.py::other", tmp_path) == "missing"
    assert pictures.digest("demos/none.py", tmp_path) == "missing"


def test_make_flange_writes_the_picture_that_readme_shows_first():
    shown = re.search(r"!\[[^\]]+\]\(docs/(\S+)\)", (ROOT / "README.md").read_text())[1]
    way, script, file = pictures.PICTURES[shown].way
    recipe = re.search(r"^flange: setup\n\t(.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)[1]
    assert way == "of_run" and recipe.endswith(f" {script}")
    assert file == Path(shown).name and f'out / "{file}"' in (ROOT / script).read_text()
