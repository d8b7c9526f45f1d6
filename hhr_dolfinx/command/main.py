"""The commands of ``hhr``.

Exit codes: 0 all is well; 1 something has no answer, or a check found mistakes; 2 wrong words; 3 a
scene, a model or a file is refused; 130 interrupted.
"""

from __future__ import annotations

import logging
import os

from hhr_dolfinx import registry
from hhr_dolfinx.command.speaking import guarded
from hhr_dolfinx.command.words import examples
from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import HHRError, NotOfferedError

with extra("study", "the command hhr"):
    import click

OWN = {
    "train": "hhr_dolfinx.command.making:train",
    "solve": "hhr_dolfinx.command.answering:solve",
}
"""Commands of the core, loaded when they are called, like those of plug-ins."""


class Commands(click.Group):
    """Commands by name: of the core and of plug-ins."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands."""
        return sorted({*self.commands, *OWN, *registry.named("commands")})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """A command by its name.

        Args:
            ctx: context of click.
            cmd_name: name of the command.

        Returns:
            The command, or None; for a plug-in whose command cannot be loaded, one that reports the
            error, which is not raised here.
        """
        if cmd_name in self.commands:
            return self.commands[cmd_name]
        import_path = OWN.get(cmd_name) or registry.named("commands").get(cmd_name)
        if import_path is None:
            return None
        try:
            command = registry.load(import_path)
            if not isinstance(command, click.Command):
                raise TypeError(f"it is a {type(command).__name__} and no command of click")
        except (
            Exception,
            SystemExit,
        ) as error:  # third-party code may raise anything, and others must go on
            return _broken(cmd_name, import_path, error)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command of the words; an error names the plug-in of one that is not installed.

        Args:
            ctx: context of click.
            args: words of the command line.
        """
        if remedy := registry.remedy("commands", args[0]):
            ctx.fail(f"there is no command '{args[0]}'{remedy}")
        return super().resolve_command(ctx, args)


def _broken(name: str, place: str, error: BaseException) -> click.Command:
    """Stand-in for a command that cannot be loaded: it reports the reason when it is called."""

    @guarded
    def refuse(words: tuple[str, ...]) -> None:
        if isinstance(error, HHRError):
            raise error
        raise NotOfferedError(
            f"hhr {name} cannot be loaded from {place}: {type(error).__name__}: {error}"
        ) from error

    words = click.Argument(["words"], nargs=-1, type=click.UNPROCESSED)
    settings = {"ignore_unknown_options": True}
    short = "(cannot be loaded: call it for the reason)"
    return click.Command(
        name, callback=refuse, params=[words], short_help=short, context_settings=settings
    )


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--verbose", is_flag=True, help="say what goes on, stage by stage")
@click.version_option(package_name="hhr_dolfinx")
def hhr(verbose: bool) -> None:
    """Contact problems for many parameters: reduced models that know their error.

    A SCENE is a Python file in which `scene` is one, or a function that returns one (file.py), or
    something else in it (file.py:name).
    """
    logging.basicConfig(level=logging.INFO if verbose else logging.WARNING, format="%(message)s")


@hhr.command("list", epilog=examples("hhr list", "hhr list pairings"))
@click.argument("kind", required=False)
@guarded
def list_(kind: str | None) -> None:
    """Show what scenes may name: geometries, pairings, laws, loads, outputs, samplings, materials,
    other packages.
    """
    from hhr_dolfinx.by_name import OWN, names
    from hhr_dolfinx.materials.elasticity import MATERIALS

    kinds = [*OWN, "materials"]
    if kind is not None and kind not in kinds:
        raise click.UsageError(f"there are no {kind}: kinds are {', '.join(kinds)}")
    for listed in [kind] if kind else kinds:
        click.echo(f"{listed}:")
        if listed == "materials":
            for name, material in MATERIALS.items():
                click.echo(
                    f"  {name}: E = {material.young / 1e9:g} GPa, nu = {material.poisson:g} "
                    f"({material.source})"
                )
        else:
            for name, source in sorted(names(listed).items()):
                click.echo(f"  {name} ({source})")


def main() -> None:
    """Run the installed command."""
    # a closed output, `hhr list | head`, is not a crash; PETSc would report it as one
    os.environ["PETSC_OPTIONS"] = f"{os.environ.get('PETSC_OPTIONS', '')} -no_signal_handler"
    hhr(prog_name="hhr")


if __name__ == "__main__":
    main()
