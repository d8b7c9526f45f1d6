"""The command ``hhr start``: a scene file from a deck, or from a mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from hhr_dolfinx.command.speaking import guarded, spoken
from hhr_dolfinx.command.words import examples
from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import FileContentError, FileError, SceneError
from hhr_dolfinx.plugins.decks.deck import Deck, Left
from hhr_dolfinx.registry import tool

if TYPE_CHECKING:
    from hhr_dolfinx.geometries.raw_mesh import RawMesh

with extra("study", "the command hhr"):
    import click


@click.command(
    epilog=examples(
        "hhr start deck.inp",
        "hhr start part.msh --to part.py",
        "hhr start run.comm",
        "hhr start part.inp --stiffness part.sti --case case.inp",
    )
)
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--to", type=click.Path(path_type=Path), help="the scene file [FILE with the ending .py]"
)
@click.option(
    "--mesh",
    type=click.Path(path_type=Path),
    help="mesh of a .comm [one of the same name beside it]",
)
@click.option(
    "--stiffness", type=click.Path(path_type=Path), help="K of the deck, written by its code"
)
@click.option(
    "--case",
    type=click.Path(path_type=Path),
    help="load case that the code has solved, for --stiffness",
)
@click.option(
    "--unchecked", is_flag=True, help="take --stiffness without --case; each answer says so"
)
@click.option(
    "--dofs",
    type=click.Path(path_type=Path),
    help="node and direction of each row, for --stiffness",
)
@click.option("--force", is_flag=True, help="write over a scene file that is there")
@guarded
def start(
    file: Path,
    to: Path | None,
    mesh: Path | None,
    stiffness: Path | None,
    case: Path | None,
    unchecked: bool,
    dofs: Path | None,
    force: bool,
) -> None:
    """Write a scene file from a deck of CalculiX, Abaqus or code_aster, or a template from any
    mesh.

    Materials, supports, loads and contact pairs of the deck become parts of the scene, each with
    its line. What has no counterpart is a comment with TODO, and is printed. With --stiffness,
    elements and materials are those of another code, in a file of K that it wrote, and the deck
    gives surfaces, supports, loads and contact.
    """
    from hhr_dolfinx.command.loading import checked_target
    from hhr_dolfinx.files import replacing
    from hhr_dolfinx.plugins.decks.write import scene_text

    if file.is_dir():
        raise FileError(f"{file} is a folder: name a deck, a command file or a mesh in it")
    target = to or file.with_suffix(".py")
    checked_target(target, (".py",))
    if target.exists() and not force:
        raise FileError(
            f"{target} is there: name another file, --to my_scene.py, or write over it with --force"
        )
    console, _ = spoken()
    if stiffness is not None:
        if case is None and not unchecked:
            raise SceneError(
                "--stiffness needs --case, a load case that the same code has solved, or "
                "--unchecked"
            )
        write = tool("foreign_scene", f"a scene with the stiffness {stiffness.name}")
        for line in (
            *write(file, stiffness, target, case, dofs),
            f"{target} is written. Now: hhr check {target}",
        ):
            console.print(line, highlight=False, markup=False, soft_wrap=True)
        return
    deck = deck_of(file, mesh)
    with replacing(target, text=True) as out:
        out.write(scene_text(deck, file, target))
    then = f", and python {target} for contact and heat" if deck.heat is not None else ""
    for line in (*map(str, deck.left), f"{target} is written. Now: hhr check {target}{then}"):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    if deck.contact_lost:
        raise SceneError(
            f"{file.name} states contact, and {target} has none of it, so that its answers are "
            "those without: the TODO lines say why. Add the pairs to its contacts"
        )


def deck_of(path: Path, mesh: Path | None = None) -> Deck:
    """Contents of a deck, of a command file of code_aster, or of a mesh without physics.

    Args:
        path: the deck, the command file, or the mesh.
        mesh: mesh of a command file; None for the one with its name.

    Raises:
        FileContentError: for a file that cannot be read, with the line.
        SceneError: for a deck from which no scene can be made, with the line.
    """
    deck = _read(path, mesh)
    if not deck.pairs:
        raise SceneError(
            f"{path.name}: a scene needs a contact pair, and every node of the outside of its "
            "bodies is held. Name the surfaces to hold and to press in the file of the mesh, such "
            "as physical groups of gmsh" + "".join(f". {entry}" for entry in deck.left)
        )
    return deck


def _read(path: Path, mesh: Path | None) -> Deck:
    """Contents of a file, maybe without a contact pair."""
    from hhr_dolfinx.geometries.abaqus_deck import flat_deck
    from hhr_dolfinx.geometries.mesh_file import MeshFile, begins_as_deck
    from hhr_dolfinx.plugins.decks.comm import read_comm
    from hhr_dolfinx.plugins.decks.feb import read_febio
    from hhr_dolfinx.plugins.decks.inp import hypothesis_of, read_inp
    from hhr_dolfinx.plugins.decks.inp_nodes import DeckNodes
    from hhr_dolfinx.plugins.decks.inp_steps import of_kind
    from hhr_dolfinx.plugins.decks.keywords import blocks_of
    from hhr_dolfinx.plugins.decks.named import NamedParts
    from hhr_dolfinx.plugins.decks.template import template
    from hhr_dolfinx.registry import named

    if path.suffix.lower() == ".comm" and path.is_file():
        endings = dict.fromkeys(
            (".med", ".mmed", ".mail", ".msh", ".unv", ".inp", *named("readers"))
        )
        beside = [path.with_suffix(ending) for ending in endings]
        mesh = mesh or next((candidate for candidate in beside if candidate.is_file()), None)
        if mesh is None:
            raise FileContentError(f"{path} names no mesh: give its file, --mesh part.med")
        parts = NamedParts(MeshFile(mesh).read())
        return _without_folds(read_comm(path, mesh, parts), parts.raw)
    parts = NamedParts(MeshFile(path).read())
    deck = path.suffix.lower() == ".inp" or begins_as_deck(path)
    blocks, todo = blocks_of(path) if deck else ([], [])
    physics = of_kind(blocks, "SOLID SECTION", "STEP")
    if physics:
        return _without_folds(
            read_inp(path, blocks, parts, DeckNodes(flat_deck(path)), todo), parts.raw
        )
    if path.suffix.lower() == ".feb" and (from_file := read_febio(path, parts)) is not None:
        return _without_folds(from_file, parts.raw)
    from_file = template(
        path, parts, hypothesis_of(blocks, parts, todo) if parts.raw.dim == 2 else "solid"
    )
    return _without_folds(replace(from_file, left=(*from_file.left, *todo)), parts.raw)


def _without_folds(deck: Deck, raw: RawMesh) -> Deck:
    """The deck, with a mark if its mesh has folded cells of second order."""
    from hhr_dolfinx.plugins.second_order.untangled import folded

    if not (count := len(folded(raw))):
        return deck
    reason = (
        f"{count} cells are folded, and hhr.Untangled moves the middles of their sides: hhr check "
        "says how far. how='gmsh' moves nodes inside of bodies instead"
    )
    return replace(
        deck, folded=True, left=(*deck.left, Left(deck.path.name, "cells of second order", reason))
    )
