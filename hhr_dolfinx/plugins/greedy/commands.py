"""The option --greedy of ``hhr train`` and ``hhr study``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hhr_dolfinx.compat import extra

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.greedy.greedy import Greedy

with extra("study", "the command hhr"):
    import click


class ChosenTraining:
    """A training that chooses its points."""

    options = (
        click.option(
            "--greedy",
            type=float,
            help="train where a model is worst, up to this error of the forces",
        ),
        click.option("--budget", type=click.IntRange(2), help="most answers of a greedy training"),
    )
    names = ("greedy", "budget")

    @staticmethod
    def training(given: Mapping[str, Any]) -> Greedy:
        """The training of these options.

        Args:
            given: values of the options, by name.

        Raises:
            UsageError: for a budget without a greedy training.
        """
        from hhr_dolfinx.plugins.greedy.greedy import Greedy

        if given["greedy"] is None:
            raise click.UsageError("--budget belongs to --greedy")
        return Greedy(tolerance=given["greedy"], budget=given["budget"] or 200)
