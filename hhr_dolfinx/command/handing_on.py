"""Commands that hand models, problems and reports on to others: page, embed, serve, dakota, export, report."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hhr_dolfinx.command.speaking import guarded
from hhr_dolfinx.command.words import AT, KNOWN, SCENE, examples
from hhr_dolfinx.compat import extra

with extra("study", "the command hhr"):
    import click

DECKS = (".inp",)
EMBEDDED = (".h", ".fmu")
PAGES = (".html",)


@click.command(epilog=examples("hhr page out/my_scene/condensed.npz", "hhr page model.npz --scene my_scene.py"))
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--scene", help="what the model was made of, where no scenery.npz lies beside it")
@click.option("--out", type=click.Path(path_type=Path), help="the page [<model>.html]")
@KNOWN
@guarded
def page(model: Path, scene: str | None, out: Path | None, known: tuple[str, ...]) -> None:
    """Write one HTML page that answers as a condensed model does, in any browser, without Python and without a network.

    Contact pressures and their error, outputs and their derivatives, displacement of the mesh: sliders for all
    parameters. What it draws comes from scenery.npz, which train and reduce leave beside the model.
    """
    from hhr_dolfinx.command.loading import checked_target, model_of
    from hhr_dolfinx.pages.page import check_for_page, write_model_page

    checked_target(out, PAGES)
    loaded = model_of(model, known)
    target = out or model.with_suffix(".html")
    checked_target(target, PAGES)
    with _naming_condensed(model):
        check_for_page(loaded)  # before a scene is asked for
        click.echo(write_model_page(target, loaded, _scenery_of(model, scene)))


@click.command(epilog=examples("hhr embed model.npz --out press.h", "hhr embed model.npz --out press.fmu"))
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="the header, .h, or the unit, .fmu")
@KNOWN
@guarded
def embed(model: Path, out: Path, known: tuple[str, ...]) -> None:
    """Write a condensed model as a header of C, or as a unit for co-simulation (FMI 3.0).

    The header holds the numbers of the model and solves the contact problem, without a library. Parameters are inputs
    of a unit, outputs of the scene its outputs; it is compiled here, for this machine, and holds its sources. With
    friction in the plane a step is an increment from where the unit is.
    """
    from hhr_dolfinx.command.loading import checked_target, model_of

    checked_target(out, EMBEDDED)
    loaded = model_of(model, known)
    if out.suffix == ".h":
        from hhr_dolfinx.doors.c_header import write_c_header as write
    else:
        from hhr_dolfinx.doors.fmu import write_fmu as write
    with _naming_condensed(model):
        click.echo(write(out, loaded))


@click.command(epilog=examples("hhr dakota model.npz params.in results.out"))
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("parameters", type=click.Path(path_type=Path))
@click.argument("results", type=click.Path(path_type=Path))
@KNOWN
@guarded
def dakota(model: Path, parameters: Path, results: Path, known: tuple[str, ...]) -> None:
    """Answer one evaluation of Dakota: analysis_drivers = 'hhr dakota model.npz' of its fork interface.

    Its variables are parameters, its functions outputs of the scene, by their names; analytic gradients are exact.
    """
    from hhr_dolfinx.command.loading import model_of
    from hhr_dolfinx.doors.dakota import answer_dakota

    answer_dakota(model_of(model, known), parameters, results)


@click.command(epilog=examples("hhr serve model.npz", "hhr serve model.npz --host 127.0.0.1 --port 4242"))
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--host", default="127.0.0.1", show_default=True, help="address to listen on; 0.0.0.0 is all of them")
@click.option("--port", type=click.IntRange(0, 65535), default=4242, show_default=True, help="0 takes a free one")
@click.option("--name", default="forward", show_default=True, help="name of the model, for clients")
@KNOWN
@guarded
def serve(model: Path, host: str, port: int, name: str, known: tuple[str, ...]) -> None:
    """Serve a model over HTTP, to clients of UM-Bridge, until Ctrl-C: values, gradients, products with the Jacobian.

    Clients of this machine alone reach it, unless --host says otherwise: it asks nobody for a password.
    """
    from hhr_dolfinx.command.loading import model_of
    from hhr_dolfinx.doors.um_bridge import Server

    with Server(model_of(model, known), host, port, name) as server:
        click.echo(f"model '{name}' is served at {server.url}, until Ctrl-C")
        with suppress(KeyboardInterrupt):
            server.serve_forever()


@contextmanager
def _naming_condensed(model: Path) -> Iterator[None]:
    """Of a model that is refused, say where a condensed one lies."""
    from hhr_dolfinx.errors import NotOfferedError

    other = model.with_name("condensed.npz")
    try:
        yield
    except NotOfferedError as error:
        if model.name == other.name or not other.exists():
            raise
        raise NotOfferedError(f"{error}. A condensed model lies beside it: {other}") from error


def _scenery_of(model: Path, scene: str | None) -> Any:
    """What lies beside a model, or is made of its scene.

    Raises:
        FileError: where there is neither.
    """
    from hhr_dolfinx.errors import FileError
    from hhr_dolfinx.pages.scenery import NAME, Scenery

    if scene is not None:
        from mpi4py import MPI

        from hhr_dolfinx.command.loading import scene_of
        from hhr_dolfinx.full_order.full import FullOrderModel
        from hhr_dolfinx.study.scene.scenery import scenery_of

        return scenery_of(FullOrderModel(scene_of(scene), MPI.COMM_SELF))
    try:
        return Scenery.read(model.with_name(NAME))
    except FileNotFoundError:
        raise FileError(
            f"there is no {NAME} beside {model}, and a model in a file knows no mesh: name its scene, --scene FILE.py"
        ) from None


@click.command(epilog=examples("hhr report out/my_scene"))
@click.argument("folder", type=click.Path(path_type=Path))
@guarded
def report(folder: Path) -> None:
    """Make report.html of the report.json and the pictures in a folder: one file that needs nothing else."""
    from hhr_dolfinx.study.report.page import write_page

    click.echo(write_page(folder))


@click.command(epilog=examples("hhr export my_scene.py --at load=3 --out my_scene.inp"))
@SCENE
@AT
@click.option("--out", type=click.Path(path_type=Path), required=True, help="the deck, .inp")
@guarded
def export(scene: str, words: tuple[str, ...], out: Path) -> None:
    """Write the problem of one parameter as a deck for CalculiX or Abaqus, to check it there."""
    from mpi4py import MPI

    from hhr_dolfinx.command.loading import checked_target, point_of, scene_of
    from hhr_dolfinx.full_order.deck import write_deck
    from hhr_dolfinx.full_order.discretisation import Discretisation

    checked_target(out, DECKS)
    made = scene_of(scene)
    write_deck(out, Discretisation(made, MPI.COMM_SELF), point_of(words, made.parameters))
    click.echo(out)
