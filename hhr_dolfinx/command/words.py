"""Options and parameters of several commands, and their exit codes."""

from __future__ import annotations

from pathlib import Path

from hhr_dolfinx.compat import extra

with extra("study", "the command hhr"):
    import click

EXIT_NO_ANSWER = 1
"""Exit code for missing answers, or for mistakes that a check found."""


def examples(*lines: str) -> str:
    """Lines below the options of a command."""
    return "\b\n" + "\n".join(f"  {line}" for line in ("Examples:", *lines))


SCENE = click.argument("scene")
OUT = click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="folder of the results [out/NAME, that of Scene(name=...)]",
)
FIELDS = click.option(
    "--fields",
    type=click.Choice(["all", "surface", "none"]),
    default="all",
    show_default=True,
    help="none: forces and outputs alone; surface: what pictures in space show; smaller files",
)
AT = click.option(
    "--at", "words", multiple=True, help="values of parameters: name=value, or several with commas"
)

KNOWN_OPTION = click.option(
    "--known",
    multiple=True,
    help="user-defined class of the model, law.py:Voce; once for each [none]",
)
"""Option for user-defined classes in a file."""


class PartArgument(click.ParamType):
    """``3/8``, the third of eight."""

    name = "i/n"

    def convert(
        self, value: str, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        """Both numbers of a part, see :class:`click.ParamType`.

        Args:
            value: the word, ``3/8``.
            param: parameter of the command.
            ctx: context of click.
        """
        words = str(value).split("/")
        if (
            len(words) != 2
            or not all(word.isdecimal() for word in words)
            or not 1 <= int(words[0]) <= int(words[1])
        ):
            self.fail(f"{value!r} is no part: write 3/8, the third of eight", param, ctx)
        return int(words[0]), int(words[1])


PART_OPTION = click.option(
    "--part", type=PartArgument(), help="one part of it alone, as 3/8: a job of an array"
)
"""Option for one part of the work alone."""
