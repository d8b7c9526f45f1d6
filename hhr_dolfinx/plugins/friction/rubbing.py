"""Friction and a law of the pressures, as a user gives both to one pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hhr_dolfinx.contact.law import PairLaw
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.friction.pair_laws import Coulomb, Tangential, Tresca

if TYPE_CHECKING:
    from hhr_dolfinx.scene import Scene


@dataclass(frozen=True)
class Rubbing(Tangential):
    """Friction of a pair over a law of its pressures, as ``friction`` and ``law`` state both."""

    friction: Coulomb | Tresca
    under: PairLaw

    @property
    def coefficient(self) -> float | str | None:  # type: ignore[override]
        """Of friction."""
        return self.friction.coefficient

    @property
    def limit(self) -> float | str | None:  # type: ignore[override]
        """Of friction."""
        return self.friction.limit

    @property
    def texts(self) -> tuple[str, ...]:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`."""
        return (*self.friction.texts, *self.under.texts)

    @property
    def words(self) -> str:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`."""
        return f"{self.friction.words} over {self.under.words}"

    def check(self, scene: Scene, what: str) -> None:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`.

        Args:
            scene: the scene.
            what: description of the contact for the message.
        """
        super().check(scene, what)
        self.under.check(scene, what)


def rubbing(laws: Sequence[PairLaw], what: str) -> Rubbing:
    """Tool ``laws_of_a_pair``: friction and one law of the pressures.

    Args:
        laws: laws of a pair.
        what: description of the pairing for messages.

    Raises:
        SceneError: for others.
    """
    friction = [law for law in laws if isinstance(law, Coulomb | Tresca)]
    under = [law for law in laws if not isinstance(law, Tangential)]
    if len(friction) != 1 or len(under) != 1 or len(laws) != 2:
        raise SceneError(
            f"{what} has several laws, {', '.join(law.words for law in laws)}: a pair has one of "
            "its pressures, and one of friction"
        )
    return Rubbing(friction[0], under[0])
