"""The site: pages of this folder, a gallery of ten demos, a page for each other one, and the
reference from docstrings.

`make docs` builds it.
"""

import ast
import os
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
FOLDERS = "docs", "demos", "benchmarks", "benchmarks/thesis"
sys.path[:0] = [str(ROOT / name) for name in FOLDERS]
os.environ.setdefault("OMP_NUM_THREADS", "1")  # small problems get no faster by more

try:
    import dolfinx_solver  # noqa: F401  the wheel wants to be first
except ImportError:
    pass
from gallery_order import GALLERY  # noqa: E402

import hhr_dolfinx  # noqa: E402

project = "hhr_dolfinx"
author = "The hhr_dolfinx authors"
release = hhr_dolfinx.__version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
]
# myst_nb would read the notebooks of the gallery as pages
exclude_patterns = ["README.md", "gallery/*.ipynb"]

sphinx_gallery_conf = {
    "examples_dirs": "../demos",
    "gallery_dirs": "gallery",
    "ignore_pattern": rf"^(?!.*\b({'|'.join(GALLERY)})\.py$)",
    "within_subsection_order": "gallery_order.place",
    "plot_gallery": False,  # they take minutes: pages show pictures that `make pictures` has made
    "remove_config_comments": True,
    "show_memory": False,
    "write_computation_times": False,
    # a notebook has no file of its own, beside which scripts look for their meshes
    "first_notebook_cell": "# this notebook runs in the folder demos/ of a checkout\n"
    '__file__ = "notebook"',
    "notebook_images": True,  # inside of the notebook, which is alone where it is put
    "download_all_examples": False,
    "thumbnail_size": (400, 280),
}

html_theme = "furo"
html_title = f"hhr_dolfinx {release}"
html_static_path: list[str] = []
html_extra_path = ["../out/site_extra"]  # pages that the tutorial writes
html_theme_options = {"source_edit_link": "", "top_of_page_buttons": []}

myst_heading_anchors = 3
nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / "out" / "site_cache")
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True

autodoc_default_options = {"members": True}
autodoc_typehints = "none"  # signatures say enough
autodoc_member_order = "bysource"
napoleon_use_ivar = True
python_use_unqualified_type_names = True
# docstrings name modules that the reference does not list, and single letters of the thesis
suppress_warnings = ["ref.python", "misc.highlighting_failure"]


def write_demo_pages(folder: Path) -> None:
    """One page for each demo that is not in the gallery: what it says of itself, its pictures, the
    tests that hold it to figures, its source.
    """
    folder.mkdir(exist_ok=True)
    tests = {
        str(path.relative_to(ROOT)): path.read_text()
        for path in sorted((ROOT / "tests").rglob("test_*.py"))
    }
    names = []
    thesis = [
        path
        for path in sorted((ROOT / "benchmarks/thesis").glob("*.py"))
        if "def main" in path.read_text()
    ]
    others = [path for path in (ROOT / "demos").glob("*.py") if path.stem not in GALLERY]
    for path in (*sorted(others), *thesis):
        title, _, rest = ast.get_docstring(ast.parse(path.read_text())).partition("\n")
        held = [
            name
            for name, text in tests.items()
            if f"import {path.stem}" in text or f"{path.stem}.py" in text
        ]
        picture = ROOT / "docs" / "pictures" / f"{path.stem}.png"
        lines = [f"# {title.rstrip('.').replace('_', ' ')}", "", myst(rest), ""]
        lines += [f"![{title}](../pictures/{picture.name})", ""] if picture.exists() else []
        lines += (
            [f"Held to figures by {', '.join(f'`{name}`' for name in held)}.", ""] if held else []
        )
        lines += [
            "## Source",
            "",
            f"`{path.relative_to(ROOT)}`",
            "",
            f"```{{literalinclude}} ../../{path.relative_to(ROOT)}",
            "```",
            "",
        ]
        write_if_new(folder / f"{path.stem}.md", "\n".join(lines))
        names.append(path.stem)
    toctree = ["```{toctree}", ":maxdepth: 1", "", *names, "```", ""]
    said = (
        "Ten demos are in the [gallery](../gallery/index.rst). Each of the others is a file of "
        "`demos/`, or of `benchmarks/thesis/` for the cases of the thesis, with its equations; "
        "`make` runs most of them by name ([studies](../studies.md))."
    )
    for page in folder.glob("*.md"):  # of an earlier build
        if page.stem not in (*names, "index"):
            page.unlink()
    write_if_new(
        folder / "index.md",
        "\n".join(["# Other demos, and cases of the thesis", "", said, "", *toctree]),
    )


def myst(text: str) -> str:
    """The text of a docstring as Markdown: blocks that are indented stay as they are."""
    lines = []
    fenced = False
    for line in text.strip("\n").splitlines():
        indented = line.startswith("    ")
        if line.strip() and indented != fenced:
            lines.append("```" if fenced else "```text")
            fenced = indented
        lines.append(line[4:] if indented else line.replace("``", "`"))
    return "\n".join([*lines, "```"] if fenced else lines)


def write_if_new(path: Path, text: str) -> None:
    """Write what has changed, so that a second build reads little."""
    if not path.exists() or path.read_text() != text:
        path.write_text(text)


def escape_bars(
    _app: object, _what: str, _name: str, _obj: object, _options: object, lines: list[str]
) -> None:
    """Norms such as |v|_K are no substitutions of reStructuredText."""
    lines[:] = [line.replace("|", "\\|") for line in lines]


def setup(app: Any) -> None:
    """What Sphinx calls first."""
    app.connect("autodoc-process-docstring", escape_bars)


(ROOT / "out" / "site_extra").mkdir(parents=True, exist_ok=True)
write_demo_pages(Path(__file__).parent / "demos")
