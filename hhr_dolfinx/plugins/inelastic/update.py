"""Constitutive update of all Gauss points, by the laws of their bodies."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np

from hhr_dolfinx.amplitudes import RANGES
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.inelastic.constants import (
    MUST,
    LawOfParameters,
    ModuliOfParameters,
    check_law_over_box,
    formulas_of,
)
from hhr_dolfinx.plugins.inelastic.law import (
    UNGRADED,
    InternalVariables,
    LawNumbers,
    LawProgram,
    Update,
    hooke,
)
from hhr_dolfinx.plugins.inelastic.local_solver import Code, code_of


@dataclass(frozen=True)
class Group:
    """Gauss points of one body."""

    indices: Annotated[Integers, "points"]  #: numbers among the model's Gauss points, (n,)
    young: float | str  #: Young's modulus E, or a formula of the parameters
    poisson: float | str  #: Poisson's ratio, or a formula
    law: LawProgram | None  #: its constants may be formulas of the parameters; None for elasticity
    coordinates: tuple[
        str, ...
    ] = ()  #: names that formulas of its law may have for places; empty if none has
    #: places of these points, (n, d), if formulas of its law name coordinates
    places: Annotated[Floats, "placed", "coordinates"] = field(
        default_factory=lambda: np.zeros((0, 0))
    )
    #: factor of the elasticity at each of these points, (n,); empty for 1
    grading: Annotated[Floats, "graded"] = field(default_factory=lambda: UNGRADED)

    @cached_property
    def own(self) -> slice | np.ndarray:
        """Its indices, as a slice, which copies nothing, if they are consecutive."""
        indices = self.indices
        consecutive = indices.size and np.array_equal(
            indices, np.arange(indices[0], indices[0] + indices.size)
        )
        return slice(indices[0], indices[-1] + 1) if consecutive else indices

    def some(self, numbers: np.ndarray, indices: np.ndarray) -> Group:
        """Group of some of its points, by their numbers among the Gauss points, with other indices,
        (k,) each.
        """
        if not self.coordinates and not self.grading.size:
            return replace(self, indices=indices)
        order = np.argsort(self.indices)
        rows = order[np.searchsorted(self.indices[order], numbers)]
        coordinates = self.places[rows] if self.coordinates else self.places
        grading = self.grading[rows] if self.grading.size else self.grading
        return replace(self, indices=indices, places=coordinates, grading=grading)

    @property
    def texts(self) -> dict[str, str]:
        """Formulas of its elastic constants, by name."""
        return {name: text for name in RANGES if isinstance(text := getattr(self, name), str)}

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults of the elastic constants."""
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if not (isinstance(value, str) or low < value < high):
                yield f"young = {self.young!r} and poisson = {self.poisson!r} are no constants"
        if self.grading.size not in (0, self.indices.size) or not (self.grading > 0).all():
            yield (
                f"a grading of {self.grading.size} points must be positive at each of "
                f"{self.indices.size} points"
            )
        if self.coordinates and self.places.shape != (self.indices.size, len(self.coordinates)):
            yield (
                f"places of the shape {self.places.shape} are not one for each of "
                f"{self.indices.size} points"
            )

    def elasticity(self, components: int) -> tuple[np.ndarray, np.ndarray]:
        """C and C^-1 for the grading 1, (c, c) each; E and ν must be numbers."""
        if (
            self.law is not None and self.law.strains == components
        ):  # else a fault, which a file is refused for
            return self.law.elasticity(*self.numbers())
        return hooke(*self.numbers(), components)

    def given(self, components: int) -> LawNumbers:
        """Constants and elasticity, which must be numbers."""
        if self.law is None:
            return LawNumbers(np.zeros((0, 1)), *self.elasticity(components), self.grading)
        numbers = self.law.given(*self.numbers())
        if not self.grading.size:
            return numbers
        constants = numbers.constants * np.ones(self.grading.size)
        constants[0] *= self.grading
        return numbers._replace(constants=constants, grading=self.grading)

    def numbers(self) -> tuple[float, float]:
        """E and ν.

        Raises:
            SceneError: for one that is a formula.
        """
        for name, text in self.texts.items():
            raise SceneError(
                f"{name} = {text} is a formula of the parameters: material.moduli_at(point) has "
                "its number"
            )
        assert not isinstance(self.young, str) and not isinstance(self.poisson, str)
        return self.young, self.poisson


class LastOf:
    """Keeps the value of the last key; threads may share it."""

    def __init__(self) -> None:
        self._last: tuple[object, Any] = None, None

    def of(self, key: object, make: Callable[[], Any]) -> Any:
        """The value of a key, which is not None.

        Args:
            key: key to look for.
            make: makes the value, unless the last key is the same.
        """
        last = self._last
        if last[0] is not key and last[0] != key:
            self._last = last = key, make()  # in one assignment: several threads may be here
        return last[1]


class Material:
    """Laws of all Gauss points of a model.

    Args:
        groups: one group for each body; every Gauss point is in one group.
        components: number of components of a strain, 4 or 6.
        names: names of the parameters, for formulas.

    Raises:
        SceneError: if a Gauss point is in no group or in two, as the compiled loops would access
            other memory; for formulas of unknown parameters.
    """

    kept: ClassVar[tuple[str, ...]] = ("groups", "components", "names")
    """Attributes that a file stores."""

    def __init__(self, groups: Sequence[Group], components: int, names: Sequence[str] = ()):
        self.groups = tuple(groups)
        self.components = components
        self.names = tuple(names)
        numbered = list(enumerate(self.groups))
        self._laws = {
            k: LawOfParameters(group.law, names, group.coordinates, group.places)
            for k, group in numbered
            if formulas_of(group.law)
        }
        texts = {(k, name): text for k, group in numbered for name, text in group.texts.items()}
        self._moduli = ModuliOfParameters(texts, self.names) if texts else None
        self._at_points = LastOf()
        self._at_moduli = LastOf()
        self.gauss_points = sum(group.indices.size for group in self.groups)
        indices = np.concatenate(
            [np.zeros(0, dtype=np.int64), *(group.indices for group in self.groups)]
        )
        if not np.array_equal(np.sort(indices), np.arange(self.gauss_points)):
            raise SceneError(
                "the groups of a material must hold each of its Gauss points 0 .. "
                f"{self.gauss_points - 1} once"
            )
        if self._moduli is None:
            _ = self.elastic

    def faults_for(self, space: ParameterSpace, dimension: int) -> Iterator[str]:
        """Faults of a material read from a file.

        Args:
            space: box of the parameters.
            dimension: dimension of the mesh.

        Raises:
            SceneError: for a formula with invalid values in the box.
        """
        if self.components != (4 if dimension == 2 else 6) or self.names not in ((), space.names):
            yield (
                f"a strain has {self.components} components in dimension {dimension}, and "
                f"parameters {self.names}"
            )
        for number, group in enumerate(self.groups):
            if group.law is not None:
                check_law_over_box(
                    group.law, space, f"law {number}", group.coordinates, group.places
                )
                if group.law.strains != self.components:
                    yield (
                        f"law {number} is one of {group.law.strains} components of a strain, of "
                        f"{self.components}"
                    )
            for name, text in group.texts.items():
                from hhr_dolfinx.formulas import Scalar, check_over_box

                check_over_box(Scalar(text, space.names), space, name, *RANGES[name], MUST[name])

    @cached_property
    def elastic(self) -> np.ndarray:
        """Elastic tangents, (gauss_points, components, components).

        Moduli must be numbers, see :meth:`moduli_at`.
        """
        elastic = np.empty((self.gauss_points, self.components, self.components))
        for group in self.groups:
            elastic[group.indices] = group.elasticity(self.components)[0]
            if group.grading.size:
                elastic[group.indices] *= group.grading[:, None, None]
        return elastic

    @cached_property
    def grading(self) -> np.ndarray:
        """Factor of the elasticity at each point, (gauss_points,); empty if it is 1 at all of
        them.
        """
        graded = [group for group in self.groups if group.grading.size]
        factors = np.ones(self.gauss_points if graded else 0)
        for group in graded:
            factors[group.indices] = group.grading
        return factors

    @property
    def flows(self) -> bool:
        """True if any body is inelastic."""
        return any(group.law is not None for group in self.groups)

    @property
    def linear(self) -> bool:
        """True if all laws are linear elasticity, so that nothing flows whatever the loads."""
        return all(group.law is None or group.law.linear for group in self.groups)

    @property
    def rated(self) -> bool:
        """True if any law depends on rates."""
        return any(group.law is not None and group.law.rated for group in self.groups)

    @cached_property
    def code(self) -> Code:
        """Programs of the laws of all groups that have one, kept for materials with other
        constants.
        """
        return code_of([group.law.coded for group in self.groups if group.law is not None])

    @property
    def remembered(self) -> int:
        """Largest number of further internal variables of any law."""
        return max(
            (int(group.law.sizes[2:].sum()) for group in self.groups if group.law is not None),
            default=0,
        )

    def restricted(self, indices: np.ndarray, *, empty: bool = False) -> Material:
        """Material of some Gauss points, renumbered in their order.

        Args:
            indices: numbers of the points, (n,).
            empty: keep groups without any.
        """
        members = [np.flatnonzero(np.isin(indices, group.indices)) for group in self.groups]
        groups = [
            group.some(indices[numbers], numbers)
            for group, numbers in zip(self.groups, members, strict=True)
            if empty or numbers.size
        ]
        return Material(groups, self.components, self.names)

    def at(self, point: np.ndarray) -> Material:
        """Material with the constants at a point, (P,), the last of which is kept.

        Itself if none is a formula.

        SceneError for constants that are not valid there.
        """
        elastic = self.moduli_at(point)
        if not self._laws:
            return elastic

        def made() -> Material:
            material = copy(elastic)
            laws = {body: law.at(point) for body, law in self._laws.items()}
            groups = enumerate(elastic.groups)
            material.groups = tuple(
                replace(group, law=laws.get(k, group.law)) for k, group in groups
            )
            material._laws = {}
            vars(material).pop("given", None)
            with suppress(NotOfferedError):  # of laws without programs
                material.code = elastic.code  # the same for any constants
            return material

        return self._at_points.of(point.tobytes(), made)

    def moduli_at(self, point: np.ndarray) -> Material:
        """Material with the elasticity at a point, (P,), the last of which is kept.

        Itself if that is constant.

        SceneError for a modulus that is not valid there.
        """
        if self._moduli is None:
            return self
        values = self._moduli.values(point)

        def made() -> Material:
            material = copy(self)
            groups = enumerate(self.groups)
            material.groups = tuple(
                replace(
                    group,
                    young=values.get((k, "young"), group.young),
                    poisson=values.get((k, "poisson"), group.poisson),
                )
                for k, group in groups
            )
            material._moduli = None
            for name in ("elastic", "given"):
                vars(material).pop(name, None)
            material._at_points = LastOf()
            return material

        return self._at_moduli.of(values, made)

    def weights(self, point: np.ndarray) -> list[float]:
        """Weights at a point, (P,), of the parts of a stiffness by its formulas: E of each, or λ
        and μ by those of ν.

        In plane stress λ is that of the plane. SceneError for impossible elastic constants.
        """
        weights_by_formula: dict[tuple[float | str, float | str, bool], tuple[float, ...]] = {}
        for group, local in zip(self.groups, self.moduli_at(point).groups, strict=True):
            if not group.texts:
                continue
            flat = group.law is not None and group.law.plane_stress
            young, poisson = local.numbers()
            if isinstance(group.poisson, str):
                stiff, _ = hooke(young, poisson, self.components, plane_stress=flat)
                weights_by_formula[group.young, group.poisson, flat] = (
                    float(stiff[0, 1]),
                    float(stiff[-1, -1]) / 2,
                )
            else:
                weights_by_formula[group.young, "", flat] = (young,)
        return [weight for weights in weights_by_formula.values() for weight in weights]

    def constants(self, point: np.ndarray) -> list[dict[str, float | np.ndarray]]:
        """Values at a point, (P,), of the constants that are formulas, for each group by name."""
        by_group = [
            self._laws[body].constants(point) if body in self._laws else {}
            for body in range(len(self.groups))
        ]
        for (body, name), value in (
            {} if self._moduli is None else self._moduli.values(point)
        ).items():
            by_group[body][name] = value
        return by_group

    def constants_along(self, point: np.ndarray, directions: np.ndarray) -> list[np.ndarray]:
        """Derivatives of E, ν and the constants of each group at a point, (P,), along directions,
        (P, K).

        They are (2 + constants, points, K), or (2 + constants, 1, K) if all points share them.
        """
        moduli = {} if self._moduli is None else self._moduli.along(point, directions)
        nothing = np.zeros((1, directions.shape[1]))
        slopes = []
        for body, group in enumerate(self.groups):
            names = () if group.law is None else group.law.constants
            changes = self._laws[body].along(point, directions) if body in self._laws else {}
            young = moduli[body, "young"][None] if (body, "young") in moduli else nothing
            ratio = moduli[body, "poisson"][None] if (body, "poisson") in moduli else nothing
            young = young * group.grading[:, None] if group.grading.size else young
            rows = np.broadcast_arrays(
                young, ratio, *(changes.get(name, nothing) for name in names)
            )
            slopes.append(np.array(rows))
        return slopes

    def at_rest(self) -> InternalVariables:
        """State without inelastic strain."""
        points = self.gauss_points
        return InternalVariables(
            np.zeros((points, self.components)),
            np.zeros(points),
            np.zeros((points, self.remembered)),
        )

    @cached_property
    def given(self) -> tuple[LawNumbers, ...]:
        """Constants and elasticity of each group, which must be numbers, see :meth:`at`."""
        return tuple(group.given(self.components) for group in self.groups)

    def update(
        self, strain: np.ndarray, old: InternalVariables, dt: float, *, tangent: bool
    ) -> Update:
        """Stress and state at the end of a step, by laws whose constants are numbers, see
        :meth:`at`.

        Args:
            strain: total strain at the end of the step, (gauss_points, components).
            old: state before the step; not modified.
            dt: length of the step in seconds.
            tangent: compute consistent tangents.

        Raises:
            ConvergenceError: if a law finds no answer, or has none.
        """
        law = self.groups[0].law
        if len(self.groups) == 1 and law is not None and self.given[0].constants.shape[1] == 1:
            return law.update(strain, old, dt, self.given[0], tangent=tangent)
        stress = np.empty_like(strain)
        state = InternalVariables(
            np.zeros_like(old.inelastic), old.cumulated.copy(), old.memory.copy()
        )
        tangents = np.empty((*strain.shape, self.components)) if tangent else None
        for group, numbers in zip(self.groups, self.given, strict=True):
            points = group.own
            law = group.law
            if law is None:
                stress[points] = numbers.stress(strain[points])
                if tangents is not None:
                    tangents[points] = self.elastic[points]
                continue
            update = law.update(
                strain[points],
                InternalVariables(*(variable[points] for variable in old)),
                dt,
                numbers,
                tangent=tangent,
            )
            stress[points] = update.stress
            state.inelastic[points], state.cumulated[points] = update.state[:2]
            state.memory[points, : update.state.memory.shape[1]] = update.state.memory
            if tangents is not None:
                tangents[points] = update.tangents
        return Update(stress, state, tangents)
