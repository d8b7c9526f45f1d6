"""Command by which other programs query a model: serve."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from hhr_dolfinx.command.speaking import guarded
from hhr_dolfinx.command.words import KNOWN_OPTION, examples
from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.group import launched

with extra("study", "the command hhr"):
    import click


@click.command(
    epilog=examples("hhr serve model.npz", "hhr serve model.npz --host 127.0.0.1 --port 4242")
)
@click.argument("model", type=click.Path(path_type=Path))
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="address to listen on; 0.0.0.0 is all of them",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=4242,
    show_default=True,
    help="0 takes a free one",
)
@click.option("--name", default="forward", show_default=True, help="name of the model, for clients")
@KNOWN_OPTION
@guarded
def serve(model: Path, host: str, port: int, name: str, known: tuple[str, ...]) -> None:
    """Serve a model over HTTP, to clients of UM-Bridge, until Ctrl-C: values, gradients, products
    with the Jacobian.

    Clients of this machine alone reach it, unless --host says otherwise: it asks nobody for a
    password.
    """
    from hhr_dolfinx.command.loading import model_of
    from hhr_dolfinx.plugins.um_bridge.server import Server

    if (ranks := launched().size) > 1:
        raise NotOfferedError(
            f"one process serves a model, and {ranks} ranks were started: leave mpirun out"
        )
    with Server(model_of(model, known), host, port, name) as server:
        click.echo(f"model '{name}' is served at {server.url}, until Ctrl-C")
        with suppress(KeyboardInterrupt):
            server.serve_forever()
