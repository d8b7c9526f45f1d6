"""The command page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from hhr_dolfinx.command.speaking import guarded
from hhr_dolfinx.command.words import KNOWN_OPTION, examples
from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import FileError, NotOfferedError, SceneWarning

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.pages.scenery import Scenery

with extra("study", "the command hhr"):
    import click

PAGES = (".html",)


@click.command(
    epilog=examples("hhr page out/my_scene/condensed.npz", "hhr page model.npz --scene my_scene.py")
)
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--scene", help="what the model was made of, where no scenery.npz lies beside it")
@click.option("--out", type=click.Path(path_type=Path), help="the page [<model>.html]")
@KNOWN_OPTION
@guarded
def page(model: Path, scene: str | None, out: Path | None, known: tuple[str, ...]) -> None:
    """Write one HTML page that answers as a condensed model does, in any browser, without Python
    and without a network.

    Contact pressures and their error, outputs and their derivatives, displacement of the mesh:
    sliders for all parameters. What it draws comes from scenery.npz, which train and reduce leave
    beside the model.
    """
    from hhr_dolfinx.command.loading import any_model_of, checked_target
    from hhr_dolfinx.plugins.pages.added import OwnPage
    from hhr_dolfinx.plugins.pages.page import check_for_page, write_model_page
    from hhr_dolfinx.warn import ignored

    checked_target(out, PAGES)
    loaded = any_model_of(model, known)
    target = out or model.with_suffix(".html")
    checked_target(target, PAGES)
    with naming_condensed(model):
        check_for_page(loaded)  # before a scene is needed
        # the scene of a model that is more than contact may name what contact alone does not read
        quiet = ignored(SceneWarning) if isinstance(loaded, OwnPage) else nullcontext()
        with quiet:
            scenery = _scenery_of(model, scene)
        click.echo(write_model_page(target, loaded, scenery))


def _scenery_of(model: Path, scene: str | None) -> Scenery:
    """Scenery from the file next to a model, or from its scene."""
    from hhr_dolfinx.plugins.pages.scenery import SCENERY_FILE, Scenery

    if scene is not None:
        from mpi4py import MPI

        from hhr_dolfinx.command.loading import scene_of
        from hhr_dolfinx.full_order.full import FullOrderModel
        from hhr_dolfinx.plugins.pages.scenery_of import scenery_of

        return scenery_of(FullOrderModel(scene_of(scene), MPI.COMM_SELF))
    try:
        return Scenery.read(model.with_name(SCENERY_FILE))
    except FileNotFoundError:
        raise FileError(
            f"there is no {SCENERY_FILE} beside {model}, and a model in a file knows no "
            f"mesh: name its "
            "scene, --scene FILE.py"
        ) from None


@contextmanager
def naming_condensed(model: Path) -> Iterator[None]:
    """If a model is refused, name the condensed one next to it.

    Raises:
        NotOfferedError: the refusal, which also names the condensed model if there is one.
    """
    condensed = model.with_name("condensed.npz")
    try:
        yield
    except NotOfferedError as error:
        if model.name == condensed.name or not condensed.exists():
            raise
        raise NotOfferedError(f"{error}. A condensed model lies beside it: {condensed}") from error
