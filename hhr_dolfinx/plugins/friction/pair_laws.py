"""Laws of friction as a user gives them to a contact pair."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from hhr_dolfinx.contact.law import MeshArrays, PairLaw
from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import NotOfferedError, SceneError, SceneWarning
from hhr_dolfinx.formulas import formula_of
from hhr_dolfinx.plugins.friction.laws import Friction, FrictionLaw, check_finite
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

    from hhr_dolfinx.contact.rows import ContactRows
    from hhr_dolfinx.scene import Scene


class Tangential(KnownArguments, PairLaw):
    """A law of the tangential forces of a contact pair, by two constants."""

    plugin: ClassVar[str] = "friction"
    coefficient: float | str | None
    limit: float | str | None
    under: PairLaw | None = None  #: law of the pressures

    @property
    def texts(self) -> tuple[str, ...]:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`."""
        return tuple(text for text in (self.coefficient, self.limit) if isinstance(text, str))

    @property
    def words(self) -> str:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`."""
        texts = [] if self.coefficient is None else [f"friction {self.coefficient}"]
        texts += [] if self.limit is None else [f"shear stress up to {self.limit}"]
        return ", ".join(texts)

    def check(self, scene: Scene, what: str) -> None:
        """Warn of a coefficient that looks like an angle or a percentage, see :class:`PairLaw`.

        Args:
            scene: scene of the pair.
            what: pair of the law, for messages.
        """
        coefficient = FrictionLaw.of(self, scene.parameters, what).coefficient
        if (
            coefficient is not None
            and LARGE_COEFFICIENT < (value := coefficient.value(scene.parameters.middle)) < ROUGH
        ):
            angle = (
                f"; of an angle of {value:g} degrees it is {np.tan(np.radians(value)):.3g}"
                if value < 90
                else ""
            )
            warn(
                f"{what}: a coefficient of friction of {value:g} is more than rubber has, about "
                f"1. It is a ratio of forces, no angle and no percentage{angle}",
                SceneWarning,
            )

    @classmethod
    def attached(
        cls,
        laws: Mapping[int, Tangential],
        scene: Scene,
        rows: ContactRows,
        pairs: np.ndarray,
        free: np.ndarray,
        lifts: csc_matrix,
        mesh: MeshArrays,
    ) -> tuple[ContactRows, np.ndarray, Friction]:
        """Append the tangential rows of the pairs, see :class:`PairLaw`.

        Args:
            laws: laws by pair.
            scene: scene of the contacts.
            rows: conditions of the pressures.
            pairs: contact pair of each of them, (n,).
            free: dofs that are not imposed, (N,) bool.
            lifts: imposed displacements, (N, 1 + T).
            mesh: nodes and cells.
        """
        from hhr_dolfinx.plugins.friction.over import over_laws
        from hhr_dolfinx.plugins.friction.tangents import Mesh, with_tangents

        friction_laws = {
            pair: FrictionLaw.of(law, scene.parameters, f"contact {pair}")
            for pair, law in laws.items()
        }
        shaped: set[str] = set().union(*(shape.variables for shape in scene.shapes))

        def places(some: set[str]) -> np.ndarray:
            return np.array(
                [k for k, name in enumerate(scene.parameters.names) if name in some], dtype=np.int64
            )

        longer, of_pairs, friction = with_tangents(
            rows,
            pairs,
            friction_laws,
            free,
            lifts,
            places(scene.named),
            places(shaped),
            Mesh(*mesh),
        )
        rigid = [pair for pair in laws if getattr(scene.contacts[pair], "same_everywhere", False)]
        everywhere = np.isin(pairs[friction.normal], rigid)
        friction = replace(friction, spacing=np.where(everywhere, 0.0, friction.spacing))
        under = {pair: law.under for pair, law in laws.items() if law.under is not None}
        friction = over_laws(friction, under, scene, rows, pairs, free, lifts, mesh)
        return longer, of_pairs, friction


@dataclass(frozen=True)
class Coulomb(Tangential):
    """Coulomb's law: the shear stress of a contact is at most a coefficient times its pressure.

    In nodal forces |τ| <= min(coefficient λ, limit area).

    Attributes:
        coefficient: not negative; a number, or an expression of the parameters.
        limit: largest shear stress at any pressure, in the unit of stress; a number or an
            expression; None for no limit.

    Example:
        >>> law = hhr.Coulomb("mu", limit=80.0)
        >>> hhr.Obstacle("shoe", normal=(0, -1), offset=0.0, law=law).law.words
        'friction mu, shear stress up to 80.0'
    """

    coefficient: float | str
    limit: float | str | None = None

    def __post_init__(self) -> None:
        _check_constant(self.coefficient, "coefficient")
        if self.limit is not None:
            _check_constant(self.limit, "limit")


@dataclass(frozen=True)
class Tresca(Tangential):
    """Tresca's law: the tangential stress is at most a given one at any pressure, also on open
    contacts.

    This is the classical problem, which has one solution. For a stress that vanishes on open
    contacts use a limit of Coulomb's law, ``Coulomb(coefficient, limit)``.

    Attributes:
        limit: shear stress, not negative, in the unit of stress; a number, or an expression of the
            parameters.

    Example:
        >>> law = hhr.Tresca(limit="0.5 * yield_stress")
        >>> hhr.Obstacle("sheet", normal=(0, -1), offset=0.0, law=law).law.words
        'shear stress up to 0.5 * yield_stress'
    """

    limit: float | str
    coefficient: ClassVar[None] = None  # type: ignore[misc]

    def __post_init__(self) -> None:
        _check_constant(self.limit, "limit")


def _check_constant(value: float | str, name: str) -> None:
    """Raise SceneError for a constant of a law that is neither a finite number nor a formula."""
    if not isinstance(value, str):  # a text may be the name of a parameter
        check_finite(value, name, f"the {name} of friction")
    formula_of(value, f"the {name} of friction")


Law = Coulomb | Tresca
LARGE_COEFFICIENT = 5.0
"""Coefficient of friction in the middle of the box above which it may be an angle or a
percentage.
"""
ROUGH = 1e3
"""Coefficient from which on it states surfaces that never slip."""
STICK = 0.1
"""Stiffness of sticking contacts in a deck of CalculiX or Abaqus, as a part of that of
pressures.
"""


def law_of(friction: Law | str | float | None, what: str) -> Law | None:
    """Law for the friction that a user gave for a pair: None, a law, or the coefficient of
    Coulomb's law.

    Args:
        friction: None, a law, or the coefficient of Coulomb's law.
        what: pair of the law, for messages.

    Raises:
        SceneError: for anything else.
    """
    if friction is None or isinstance(friction, Coulomb | Tresca):
        return friction
    if not isinstance(friction, str):
        check_finite(friction, "coefficient", f"the coefficient of friction of {what}")
    try:
        return Coulomb(friction)
    except SceneError:
        raise SceneError(
            f"friction = {friction!r} of {what} is unknown: give the coefficient as a number or a "
            "formula, friction=0.3, or a law, Coulomb(0.3, limit) or Tresca(limit)"
        ) from None


class _Deck:
    """Facet ``deck``, see :class:`hhr_dolfinx.plugins.exporters.deck.LawInDeck`."""

    def limited(self, law: Tangential) -> bool:
        """See :class:`hhr_dolfinx.plugins.exporters.deck.LawInDeck`.

        Raises:
            NotOfferedError: for friction over another law.
        """
        if law.under is not None:
            raise NotOfferedError(f"a deck of contacts with {law.words} is not built in")
        return law.limit is not None

    def lines(
        self, law: Tangential, number: Callable[[float | str], float], penalty: float
    ) -> Iterator[str]:
        """Lines of the law in a deck of CalculiX.

        Args:
            law: law of the pair.
            number: function that evaluates a number or a formula.
            penalty: stiffness of the pressure.
        """
        coefficient = 0.0 if law.coefficient is None else number(law.coefficient)
        if coefficient > 0.0:  # CalculiX refuses zero
            yield from ("*FRICTION", f"{coefficient:.6g}, {STICK * penalty:.6e}")


DECK = _Deck()
