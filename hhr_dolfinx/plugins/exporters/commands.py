"""Commands that write models and problems for other programs: embed, export."""

from __future__ import annotations

from pathlib import Path

from hhr_dolfinx.command.speaking import guarded
from hhr_dolfinx.command.words import AT, KNOWN_OPTION, SCENE, examples
from hhr_dolfinx.compat import extra
from hhr_dolfinx.plugins.pages.commands import naming_condensed

with extra("study", "the command hhr"):
    import click

DECKS = (".inp",)
EMBEDDED = (".h", ".fmu")


@click.command(
    epilog=examples("hhr embed model.npz --out press.h", "hhr embed model.npz --out press.fmu")
)
@click.argument("model", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="the header, .h, or the unit, .fmu",
)
@KNOWN_OPTION
@guarded
def embed(model: Path, out: Path, known: tuple[str, ...]) -> None:
    """Write a condensed model, or one with heat, as a header of C, or as a unit for co-simulation
    (FMI 3.0).

    The header holds the numbers of the model and solves the contact problem, without a library.
    Parameters are inputs of a unit, outputs of the scene its outputs; it is compiled here, for this
    machine, and holds its sources. With friction in the plane a step is an increment from where the
    unit is.
    """
    from hhr_dolfinx.command.loading import any_model_of, checked_target

    checked_target(out, EMBEDDED)
    loaded = any_model_of(model, known)
    if out.suffix == ".h":
        from hhr_dolfinx.plugins.exporters.c_header import write_c_header as write
    else:
        from hhr_dolfinx.plugins.exporters.fmu import write_fmu as write
    with naming_condensed(model):
        click.echo(write(out, loaded))


@click.command(epilog=examples("hhr export my_scene.py --at load=3 --out my_scene.inp"))
@SCENE
@AT
@click.option("--out", type=click.Path(path_type=Path), required=True, help="the deck, .inp")
@guarded
def export(scene: str, words: tuple[str, ...], out: Path) -> None:
    """Write the problem of one parameter as a deck for CalculiX or Abaqus, to check it there."""
    from mpi4py import MPI

    from hhr_dolfinx.command.loading import checked_target, point_of, scene_of
    from hhr_dolfinx.full_order.discretisation import discretised
    from hhr_dolfinx.plugins.exporters.deck import write_deck

    checked_target(out, DECKS)
    loaded = scene_of(scene)
    write_deck(out, discretised(loaded, MPI.COMM_SELF), point_of(words, loaded.parameters))
    click.echo(out)
