"""The site: the reference has all public names, messages all errors, links lead somewhere.

The tutorial runs.
"""

import ast
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from needs import OURS, needs

import hhr_dolfinx as hhr
from hhr_dolfinx import errors

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
sys.path.append(str(DOCS))

from gallery_order import GALLERY  # noqa: E402

PAGES = sorted([*DOCS.glob("*.md"), *DOCS.glob("reference/*.md")])
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")


def anchors(page):
    """What a link may name behind ``#``: headings as GitHub and the site write them."""
    words = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", word.lower()).replace(" ", "-") for word in words}


@needs(*OURS)
def test_the_reference_has_every_public_name_once():
    text = "\n".join(page.read_text() for page in DOCS.glob("reference/*.md"))
    listed = re.findall(r"^\.\. auto(?:class|function):: hhr_dolfinx\.(\w+)$", text, re.MULTILINE)
    assert sorted(listed) == sorted(set(hhr.__all__) - {"__version__"})


def test_every_error_and_warning_has_a_line_that_says_what_to_do():
    classes = [name for name, item in vars(errors).items() if isinstance(item, type)]
    rows = [
        line for line in (DOCS / "messages.md").read_text().splitlines() if line.startswith("| `")
    ]
    missing = [
        name
        for name in classes
        if name != "HHRError" and not any(f"`{name}`" in row for row in rows)
    ]
    assert len(classes) > 30 and not missing


def test_every_page_is_in_the_table_of_contents():
    named = set(re.findall(r"^[\w/]+$", (DOCS / "index.md").read_text(), re.MULTILINE))
    assert {page.stem for page in DOCS.glob("*.md")} - {"index"} <= named


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    lost = []
    for target in LINK.findall(page.read_text()):
        place, _, anchor = target.partition("#")
        made = place.startswith(("demos/", "gallery/"))
        if "://" in target or made or page.parent.name == "demos":
            continue  # elsewhere, or a page that the site makes of a demo
        file = (page.parent / place) if place else page
        if not file.exists() or (anchor and anchor not in anchors(file)):
            lost.append(target)
    assert not lost


@pytest.mark.slow
@needs(*OURS)
def test_the_site_is_built_without_a_warning(tmp_path):
    """As `make docs` does: demos on the site are run, and what the reference lists is imported."""
    pytest.importorskip("myst_nb")
    pytest.importorskip("furo")
    pytest.importorskip("sphinx_gallery")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "--quiet",
        "--keep-going",
        "-W",
        "--builder",
        "html",
        DOCS,
        tmp_path,
    ]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr[-3000:]
    assert (tmp_path / "index.html").exists() and len([*tmp_path.glob("reference/*.html")]) > 5
    index = (tmp_path / "gallery/index.html").read_text()
    for name in GALLERY:
        page = (tmp_path / f"gallery/{name}.html").read_text()
        assert f'src="../_images/sphx_glr_{name}_thumb.png"' in index
        assert "../_images/" in page and f"/{name}.ipynb" in page and f"/{name}.py" in page


def rows_of_fidelity():
    """Cells of the table of what the thesis prints."""
    lines = (DOCS / "fidelity.md").read_text().splitlines()
    cells = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in lines
        if line.startswith("| ")
    ]
    return [row for row in cells if row[0] != "printed"]


@needs(*OURS)
def test_places_of_the_thesis_exist():
    """Files, and classes, functions and methods in them, that the table names.

    Each row says what differs.
    """
    lost = []
    for printed, places, differs in rows_of_fidelity():
        assert printed and differs
        for place in re.findall(r"`([\w/]+\.py(?:::[\w.]+)?)`", places + differs):
            file, _, name = place.partition("::")
            inside = ast.parse((ROOT / file).read_text()).body if (ROOT / file).exists() else []
            for part in name.split(".") if name else []:
                found = [item for item in inside if getattr(item, "name", None) == part]
                inside = getattr(found[0], "body", []) if found else []
            if not inside:
                lost.append(place)
    assert len(rows_of_fidelity()) > 30 and not lost


@needs(*OURS)
def test_what_the_code_quotes_of_the_thesis_is_in_the_table():
    """Numbers of equations and algorithms in words of the code.

    A call such as ``Enrich(2.0)`` is none.
    """
    listed = "\n".join(row[0] + row[2] for row in rows_of_fidelity())
    quoted = set()
    for file in (
        file for folder in ("hhr_dolfinx", "forms") for file in (ROOT / folder).rglob("*.py")
    ):
        for pattern in (r"(?<![\w`])\(([1-6]\.[1-9]\d*)\)", r"Alg\. [1-6]\.\d"):
            quoted |= set(re.findall(pattern, file.read_text()))
    missing = sorted(
        item for item in quoted if not re.search(rf"(?<![\d.]){re.escape(item)}(?!\d)", listed)
    )
    assert len(quoted) > 60 and not missing


@needs(*OURS)
def test_the_tutorial_says_what_it_is_told(tmp_path, monkeypatch, capsys):
    """All its cells, as printed, but for the folder.

    And figures in its words, against what they were told.
    """
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("Agg")
    monkeypatch.chdir(tmp_path)
    cells = re.findall(
        r"```\{code-cell\} ipython3\n(.*?)```", (DOCS / "tutorial.md").read_text(), re.DOTALL
    )
    names: dict = {}
    for cell in cells:
        code = re.sub(r"^(:tags:|%cd).*\n", "", cell, flags=re.MULTILINE)
        exec(code, names)
    pyplot.close("all")
    said = capsys.readouterr().out
    assert "1722 unknowns, 40 contact conditions" in said
    assert names["model"].reduction.met and names["varying"].reduction.met
    true = 1e6 * np.abs(names["found"] - names["known"]).max()
    assert true <= names["reduced"].solve(names["point"]).estimate().pressure <= 1.2 * true
    slipped = np.array(names["slipped"])
    assert slipped[-1] == pytest.approx(slipped[20], rel=1e-9) and slipped[20] > 10 * slipped[9]
    assert (tmp_path / "block.html").stat().st_size < 3e6
