"""Friction of contact pairs: laws over the parameter range, and the tangential rows of B.

A contact with friction has one tangential row in the plane and two in space, see
:mod:`hhr_dolfinx.plugins.friction.tangents`. The slack of such a row decreases by the relative
displacement along a tangent. Its multiplier τ is the tangential force on the slave with the
opposite sign. Coulomb's law is

    |τ| <= min(coefficient λ, limit area),

and τ is opposed to the slack of an increment unless that is zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple

import numpy as np

from hhr_dolfinx.contact.law import ContactLaw
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.errors import ParameterError, SceneError
from hhr_dolfinx.formulas import Scalar, check_over_box, formula_of
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plain import Rebuilt

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from hhr_dolfinx.contact.law import PairLaw

OPEN, STICKS, SLIPS = 0, 1, 2
"""Statuses of a contact with friction."""
_CONSTANTS = ("coefficient", "limit")
SLIPPING = 1e-3
"""Margin, as a part of its bound, within which a fitted tangential force counts as slipping: it has
no status.
"""
TOUCHING = 1e-9
"""Gap at rest up to which a contact touches, as a part of the length of the surface: gaps of
matching surfaces are round-off.
"""
SLIP = "slip"
"""Name of the :class:`SlipState` in the memory of an answer."""


@dataclass(frozen=True)
class FrictionLaw(Rebuilt):
    """A law of friction whose constants are functions of the parameters.

    None for one that it does not have.
    """

    coefficient: Scalar | None
    limit: Scalar | None

    @classmethod
    def of(cls, law: PairLaw, space: ParameterSpace, what: str) -> FrictionLaw:
        """Law of a pair over the parameter range of a scene.

        Args:
            law: user's ``Coulomb`` or ``Tresca``.
            space: box of the parameters.
            what: pair, for messages.

        Raises:
            SceneError: if a constant is negative or not finite somewhere in the range, or names an
                unknown parameter.
        """
        return cls(*(_scalar(getattr(law, name), name, space, what) for name in _CONSTANTS))

    def at(self, point: np.ndarray) -> tuple[float, float]:
        """Coefficient and limit at a point, (P,); infinite for no limit."""
        values = [
            np.inf if scalar is None else scalar.value(point)
            for scalar in (self.coefficient, self.limit)
        ]
        return values[0], values[1]


ENDLESS = ("inf", "infinity", "infinite", "rough")
"""Texts for a constant without bound, unless they are names of parameters."""
REMEDIES = {
    "coefficient": "surfaces that never slip while they touch have a large number, such as 1e6",
    "limit": (
        "leave a limit out of Coulomb if there is none, and take a Tie for surfaces that never "
        "slip nor open"
    ),
}
"""Remedy for an infinite constant of friction.

Answers had the same digits for coefficients from 1e3 to 1e12.
"""


def check_finite(value: object, name: str, called: str, names: tuple[str, ...] = ()) -> None:
    """Refuse an infinite number, or a text for it, with its remedy.

    Args:
        value: number or text.
        name: constant of the law.
        called: description of the value, for messages.
        names: names of the parameters, which are no infinite numbers.

    Raises:
        SceneError: for an infinite value.
    """
    if isinstance(value, str):
        infinite = value.strip().lower() in ENDLESS and value.strip() not in names
    else:
        infinite = isinstance(value, float | np.floating) and bool(np.isinf(value))
    if infinite:
        raise SceneError(f"{called} = {value!r} must be finite: {REMEDIES[name]}")


def _scalar(
    value: float | str | None, name: str, space: ParameterSpace, what: str
) -> Scalar | None:
    if value is None:
        return None
    called = f"the {name} of friction of {what}"
    check_finite(value, name, called, space.names)
    try:
        scalar = Scalar(formula_of(value, called).text, space.names)
    except SceneError as error:
        raise SceneError(f"{called}: {error}") from None
    remedy = (
        "it must be finite and not negative everywhere in the box: change the formula, or narrow "
        "the box"
    )
    check_over_box(scalar, space, called, -1e-300, np.inf, remedy)
    return scalar


@dataclass(frozen=True)
class Friction(ContactLaw, Rebuilt):
    """Tangential rows of B, and the bounds of their forces (C contacts with friction, T tangential
    rows).
    """

    plugin: ClassVar[str] = "friction"
    name: ClassVar[str] = "friction"
    floats: ClassVar[bool] = True

    normal: Annotated[Integers, "frictional"]  #: row of the pressure of each contact, (C,)
    area: Annotated[Floats, "frictional"]  #: its tributary area, (C,)
    spacing: Annotated[Floats, "frictional"]
    """Largest slip at which the contact is still next to the nodes it was paired with, (C,); 0 for
    an obstacle, which is the same everywhere, and if rows are updated.
    """
    law: Annotated[Integers, "frictional"]  #: index of its law in ``laws``, (C,)
    tangential: Annotated[Integers, "tangential"]
    """Tangential rows, contact by contact, (T,): none if all dofs along the surface are imposed."""
    owner: Annotated[Integers, "tangential"]  #: contact of each of them, (T,)
    tangents: Annotated[Floats, "tangential", "dimension"]  #: its unit vector, (T, dim)
    laws: tuple[FrictionLaw, ...]  #: of the pairs
    fixed: Annotated[Integers, "fixed parameters"]
    """Indices of the parameters of laws, moduli or shapes: they are constant while loads grow in
    proportion.
    """
    shaped: Annotated[
        Integers, "shaping parameters"
    ]  #: indices of those of shapes, which are constant along a path
    twice: Annotated[Integers, "said twice"]
    """Tangential rows with undetermined forces, (k,): rows that other conditions on the same nodes
    repeat, as in corners, and rows along which all nodes are imposed, whose slip is given.
    """

    @property
    def reshapes(self) -> bool:  # type: ignore[override]
        """True without limits of a shear stress: these times an area are forces."""
        return all(law.limit is None for law in self.laws)

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Missing or unsorted rows."""
        rows = np.concatenate([self.normal, self.tangential])
        if rows.size and not (
            0 <= rows.min() and rows.max() < sizes.get("N_lambda", sizes.get("m", np.inf))
        ):
            yield "rows of friction are not among the contact conditions"
        if np.unique(rows).size != rows.size:
            yield "rows of friction are there twice"
        if self.owner.size and (
            np.diff(self.owner).min(initial=0) < 0 or self.owner.max() >= self.normal.size
        ):
            yield "tangential rows belong to no contact"
        if np.bincount(self.owner, minlength=1).max() > self.tangents.shape[1] - 1:
            yield "a contact has more tangential rows than there are directions"
        if not np.isin(self.twice, self.tangential).all():
            yield "rows that are said twice are not tangential"
        if (self.area < 0).any():
            yield "areas of contacts with friction are negative"
        if (self.spacing < 0).any():
            yield "spacings of contacts with friction are negative"
        if self.law.size and not (0 <= self.law.min() and self.law.max() < len(self.laws)):
            yield "contacts have a law of friction that is not there"
        scalars = [scalar for scalar in self._scalars if scalar is not None]
        named = {
            scalar.names.index(name) for scalar in scalars for name in scalar.formula.variables
        }
        if not named <= set(self.fixed.tolist()):
            yield "a law of friction depends on a parameter that grows with the loads"

    @property
    def _scalars(self) -> list[Scalar | None]:
        """Coefficient and limit of each law."""
        return [scalar for law in self.laws for scalar in (law.coefficient, law.limit)]

    def pressing(self, count: int) -> np.ndarray:
        """See :class:`ContactLaw`: all except tangential ones."""
        return ~np.isin(np.arange(count), self.tangential)

    def distinct(self, count: int) -> np.ndarray:
        """See :class:`ContactLaw`: all except tangential ones of corners."""
        return ~np.isin(np.arange(count), self.twice)

    def kept_with(self, inside: np.ndarray, contact: csr_matrix) -> np.ndarray:
        """See :class:`ContactLaw`: tangential forces that act on no unknown are kept with their
        pressures.

        Args:
            inside: conditions in the RID, (m,) bool.
            contact: rows of B, (m, N).
        """
        mask = inside.copy()
        idle = np.diff(contact.indptr)[self.tangential] == 0
        mask[self.tangential[idle]] = inside[self.normal[self.owner[idle]]]
        return mask

    def parts(self) -> list[str | np.ndarray]:
        """See :class:`ContactLaw`."""
        texts = ["" if scalar is None else scalar.text for scalar in self._scalars]
        rows = [
            self.normal,
            self.area,
            self.law,
            self.tangential,
            self.owner,
            self.tangents,
            self.fixed,
            self.twice,
        ]
        return [*texts, *rows]

    def faults_for(self, dimension: int) -> Iterator[str]:
        """See :class:`ContactLaw`."""
        if self.tangents.shape[1] != dimension:
            yield f"tangents of friction have {self.tangents.shape[1]} components, not {dimension}"

    def check_path(self, space: ParameterSpace, points: np.ndarray) -> None:
        """Refuse a path along which bodies change their shape: slip is measured on one.

        Args:
            space: box of the parameters.
            points: parameters of the path, (steps, P).

        Raises:
            ParameterError: for such a path.
        """
        for index in self.shaped.tolist():
            if np.ptp(points[:, index]) > 0:
                raise ParameterError(
                    f"{space.names[index]} changes along the path, and the shape of bodies "
                    "depends on it: what slips is measured on one shape. Keep it as it is along "
                    "the path"
                )

    @property
    def layout(self) -> dict[str, tuple[str, ...]]:
        """See :class:`ContactLaw`."""
        of_contacts = {
            name: ("float", "frictional") for name in ("path", "work", "wear", "pressure", "bound")
        }
        return {
            "position": ("float", "tangential"),
            **of_contacts,
            "statuses": ("int", "frictional"),
        }

    @property
    def sizes(self) -> dict[str, int]:
        """See :class:`ContactLaw`."""
        return {"tangential": self.tangential.size, "frictional": self.normal.size}

    def stored(self, memory: Memory) -> dict[str, np.ndarray]:
        """See :class:`ContactLaw`."""
        return dict(memory[SLIP]._asdict())

    def restored(self, arrays: Mapping[str, np.ndarray]) -> Memory:
        """See :class:`ContactLaw`."""
        return Memory(slip=SlipState(**{name: arrays[name] for name in SlipState._fields}))

    def bounds(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficient and largest tangential force of each contact at a point, (C,) each."""
        coefficients, limits = np.array([law.at(point) for law in self.laws]).T
        limits = limits[self.law]
        return coefficients[self.law], np.where(np.isinf(limits), np.inf, limits * self.area)

    def bound_slopes(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of :meth:`bounds` along the parameters, (C, P) each.

        Zero for infinite bounds.
        """
        nothing = np.zeros(point.size)
        derivatives = [
            nothing if scalar is None else scalar.derivative(point) for scalar in self._scalars
        ]
        slopes = np.array(derivatives).reshape(len(self.laws), 2, point.size)
        return slopes[self.law, 0], slopes[self.law, 1] * self.area[:, None]

    def lengths(self, tangential: np.ndarray) -> np.ndarray:
        """Magnitude of the vector of each contact, (C,), by its tangential rows, (T,)."""
        return np.sqrt(np.bincount(self.owner, tangential**2, self.normal.size))

    def limited(
        self, forces: np.ndarray, changes: np.ndarray, fitted: np.ndarray, point: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Tangential forces up to their bound, see :class:`ContactLaw`.

        Contacts well below it stick.

        Args:
            forces: forces of all rows, (M,).
            changes: derivatives of the forces, (M, P), or none.
            fitted: rows whose forces are fitted, (M,) bool.
            point: parameter, (P,).
        """
        rows = self.tangential
        coefficient, limit = self.bounds(point)
        bounded = forces.copy()
        slopes = changes
        pressure = forces[self.normal]
        size = self.lengths(forces[rows])
        admitted = bounds(coefficient, limit, pressure)
        beyond = fitted[self.normal] & (size > admitted)
        bounded[rows] *= np.divide(admitted, size, out=np.ones(size.size), where=beyond)[self.owner]
        if changes.shape[1]:
            of_coefficient, of_limit = self.bound_slopes(point)
            with np.errstate(invalid="ignore"):  # of Tresca's law, which has no coefficient
                carried = (
                    coefficient[:, None] * changes[self.normal] + of_coefficient * pressure[:, None]
                ) * (pressure > 0)[:, None]
            of_bound = np.where((admitted < limit)[:, None], carried, of_limit)
            slopes = self._scaled(
                forces, changes, beyond, admitted / np.where(size > 0, size, 1.0), of_bound
            )
        active = bounded > 0
        sticks = active[self.normal] & (self.lengths(bounded[rows]) < (1.0 - SLIPPING) * admitted)
        active[rows] = sticks[self.owner]
        return bounded, slopes, active

    def _scaled(
        self,
        forces: np.ndarray,
        changes: np.ndarray,
        beyond: np.ndarray,
        share: np.ndarray,
        of_bound: np.ndarray,
    ) -> np.ndarray:
        """Derivatives of bound t / |t| for the vectors t of the contacts ``beyond`` it.

        ``share`` is bound / |t|.
        """
        slopes = changes.copy()
        owner = self.owner[beyond[self.owner]]
        rows = self.tangential[beyond[self.owner]]
        along = (forces[rows] / self.lengths(forces[self.tangential])[owner])[:, None]
        grown = np.zeros((share.size, slopes.shape[1]))
        np.add.at(grown, owner, along * slopes[rows])
        turned = share[owner, None] * (slopes[rows] - along * grown[owner])
        slopes[rows] = along * of_bound[owner] + turned
        return slopes

    def statuses(self, active: np.ndarray) -> np.ndarray:
        """Status of each contact from those of all rows, (M,) bool: 0 open, 1 sticks, 2 slips,
        (C,).
        """
        sticks = np.bincount(self.owner, ~active[self.tangential], self.normal.size) == 0
        return np.where(active[self.normal], np.where(sticks, STICKS, SLIPS), OPEN)

    def within(self, conditions: np.ndarray) -> Friction:
        """Friction of some conditions, (m,), in their order there.

        Raises:
            ValueError: if a contact lacks some of its rows.
        """
        contacts = np.isin(self.normal, conditions)
        rows = np.isin(self.tangential, conditions)
        if not (contacts[self.owner] == rows).all():
            raise ValueError("a pressure and its tangential rows go together")
        return replace(
            self,
            normal=places_of(self.normal[contacts], conditions),
            area=self.area[contacts],
            spacing=self.spacing[contacts],
            law=self.law[contacts],
            tangential=places_of(self.tangential[rows], conditions),
            owner=(np.cumsum(contacts) - 1)[self.owner[rows]],
            tangents=self.tangents[rows],
            twice=places_of(np.intersect1d(self.twice, conditions), conditions),
        )

    def among(self, conditions: np.ndarray) -> Friction:
        """See :class:`ContactLaw`."""
        return replace(
            self,
            normal=conditions[self.normal],
            tangential=conditions[self.tangential],
            twice=conditions[self.twice],
        )


def bounds(coefficient: np.ndarray, limit: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """min(coefficient max(0, pressure), limit).

    An infinite coefficient gives the limit at any pressure.

    Args:
        coefficient: coefficient of each contact, (C,).
        limit: upper bound of each, (C,).
        forces: pressure of each, (C,).
    """
    with np.errstate(invalid="ignore"):
        carried = coefficient * np.maximum(forces, 0.0)
    return np.minimum(np.where(np.isinf(coefficient), np.inf, carried), limit)


def places_of(some: np.ndarray, conditions: np.ndarray) -> np.ndarray:
    """Index of some conditions among others, in any order."""
    order = np.argsort(conditions)
    return order[np.searchsorted(conditions, some, sorter=order)]


class SlipState(NamedTuple):
    """State of friction (T tangential rows, C contacts)."""

    #: slack of the tangential rows since rest, also while open, from which the next increment
    #: slips: minus the relative tangential displacement of the slave, a length, (T,)
    position: np.ndarray
    #: length that each contact has slipped while closed, or while its law bears a tangential force,
    #: (C,)
    path: np.ndarray
    work: np.ndarray  #: energy dissipated by friction, force times length, (C,)
    #: pressure integrated along the slip, stress times length, (C,): depth of wear per unit of the
    #: constant of Archard's law
    wear: np.ndarray
    pressure: np.ndarray  #: current normal force λ, not over its area, (C,)
    bound: np.ndarray  #: current largest tangential force, (C,)
    statuses: np.ndarray  #: 0 open, 1 sticks, 2 slips, (C,)

    def counted(self) -> dict[str, int]:
        """See :meth:`Memory.counted`."""
        sticks, slips = (int((self.statuses == status).sum()) for status in (STICKS, SLIPS))
        return {"contacts that stick": sticks, "contacts that slip": slips}

    @classmethod
    def at_rest(cls, friction: Friction, gap: np.ndarray, point: np.ndarray) -> SlipState:
        """State without slip and without pressure; contacts that touch stick.

        Args:
            friction: friction of the rows.
            gap: gap of each contact, (C,).
            point: parameter at rest, (P,).
        """
        nothing = np.zeros(friction.normal.size)
        bound = bounds(*friction.bounds(point), nothing)
        length = friction.area.sum() ** (nothing.size / max(friction.tangential.size, 1))
        touching = gap <= TOUCHING * length
        statuses = np.where(touching, STICKS, OPEN)
        rows = np.zeros(friction.tangential.size)
        return cls(rows, nothing, nothing, nothing, nothing, bound, statuses)

    def after(
        self,
        friction: Friction,
        forces: np.ndarray,
        slack: np.ndarray,
        active: np.ndarray,
        bound: np.ndarray,
    ) -> SlipState:
        """State after an increment.

        Tangential slack is the slip of the increment. Bounds and pressures are averaged over it,
        which is exact for proportional growth; a contact that opens or closes has slipped half of
        the increment while closed.

        Args:
            friction: friction of the rows.
            forces: forces of all rows, (M,).
            slack: slacks of all rows, (M,).
            active: statuses of all rows, (M,) bool.
            bound: bounds at its end, (C,).
        """
        slip = slack[friction.tangential]
        count = friction.normal.size
        pressure = np.maximum(forces[friction.normal], 0.0)
        slipped = friction.lengths(slip)
        closed_before = (self.pressure > 0) | (self.bound > 0) | (self.statuses != OPEN)
        closed = 0.5 * (closed_before.astype(float) + ((pressure > 0) | (bound > 0)))
        mean = 0.5 * (self.pressure + pressure)
        stress = np.divide(mean, friction.area, out=np.zeros(count), where=friction.area > 0)
        work = 0.5 * (self.bound + bound) * slipped
        return SlipState(
            self.position + slip,
            self.path + slipped * closed,
            self.work + work,
            self.wear + stress * slipped,
            pressure,
            bound,
            friction.statuses(active),
        )
