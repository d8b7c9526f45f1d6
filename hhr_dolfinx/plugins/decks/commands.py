"""The command ``hhr start``: a scene file from a deck, or from a mesh."""

from __future__ import annotations

from pathlib import Path

from hhr_dolfinx.command.speaking import guarded, spoken
from hhr_dolfinx.command.words import examples
from hhr_dolfinx.compat import extra

with extra("study", "the command hhr"):
    import click


@click.command(epilog=examples("hhr start deck.inp", "hhr start part.msh --to part.py", "hhr start run.comm"))
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--to", type=click.Path(path_type=Path), help="the scene file [<file>.py, beside it]")
@click.option("--mesh", type=click.Path(path_type=Path), help="mesh of a .comm [that of the same name beside it]")
@click.option("--force", is_flag=True, help="write over a file that is there")
@guarded
def start(file: Path, to: Path | None, mesh: Path | None, force: bool) -> None:
    """Write a scene file from a deck of CalculiX, Abaqus or code_aster, or a template from any mesh.

    Materials, supports, loads and contact pairs of the deck become parts of the scene, each with its line. What has no
    counterpart is a comment with TODO, and is printed.
    """
    from hhr_dolfinx.command.loading import checked_target
    from hhr_dolfinx.errors import FileError
    from hhr_dolfinx.files import replacing
    from hhr_dolfinx.plugins.decks.read import read
    from hhr_dolfinx.plugins.decks.write import scene_text

    target = file.with_name(f"{_module(file.stem)}.py") if to is None else to
    checked_target(target, (".py",))
    if target.exists() and not force:
        raise FileError(f"{target} is there: name another file, --to my_scene.py, or write over it with --force")
    deck = read(file, mesh)
    text = scene_text(deck, target)
    with replacing(target, text=True) as out:
        out.write(text)
    console, _ = spoken()
    for left in deck.left:
        console.print(str(left), highlight=False, markup=False, soft_wrap=True)
    console.print(f"{target}: now hhr check {target}", highlight=False, markup=False, soft_wrap=True)


def _module(stem: str) -> str:
    """A stem as the name of a module."""
    return stem.replace("-", "_").replace(" ", "_")
