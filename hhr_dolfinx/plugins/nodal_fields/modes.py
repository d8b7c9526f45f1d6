"""Fields of another program as parameters: a POD basis of given fields, whose amplitudes are
parameters.

In a step of a multiphysics fixed point, thesis section 1.1.3, another program gives a field at its
nodes, such as a temperature. Its projection on the basis is a point of the parameters, at which any
model of the scene answers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from hhr_dolfinx.declared import Floats
from hhr_dolfinx.errors import FileContentError, OutsideTrainingWarning, ParameterError, SceneError
from hhr_dolfinx.files import read_arrays, replacing, write_arrays
from hhr_dolfinx.parameters import ParameterSpace, Tag
from hhr_dolfinx.plugins.nodal_fields.field import NodalField
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.volume_loads.loads import ThermalExpansion

FIELD_MODES = "hhr_dolfinx field modes"
"""Content of a file, in its header."""
MODES_VERSION = 1
"""Version of this format."""
WIDER = 0.1
"""Part of the range of each amplitude, of the given fields and the zero field, by which its box is
wider on each side.
"""


@dataclass(frozen=True, eq=False)
class FieldModes:
    """A POD basis of fields at nodes, (1.49): k orthonormal modes at n points.

    ``FieldModes.of(points, fields)`` makes it of given fields. A field is then k parameters of a
    scene, its amplitudes.

    Attributes:
        points: coordinates of the nodes, (n, dim), in the unit of the mesh.
        modes: orthonormal modes, (n, k).
        lower, upper: ends of the amplitudes, (k,).
        name: parameters are this name with 1 to k.
        tolerance: largest error of the projection of a given field at any node, in the unit of the
            field.

    Example:
        >>> x = np.linspace(0.0, 1.0, 21)
        >>> grid = np.column_stack([np.tile(x, 2), np.repeat([0.0, 1.0], 21)])
        >>> fields = [300.0 + size * grid[:, 0] ** 2 for size in (10.0, 50.0, 80.0)]
        >>> modes = hhr.FieldModes.of(grid, fields, tolerance=0.01)
        >>> modes.names, sorted(modes.amplitudes(fields[1])) == list(modes.names)
        (('T1', 'T2'), True)
    """

    points: Annotated[Floats, "field nodes", "dimension"]
    modes: Annotated[Floats, "field nodes", "field modes"]
    lower: Annotated[Floats, "field modes"]
    upper: Annotated[Floats, "field modes"]
    name: str = "T"
    tolerance: float = 0.0

    @classmethod
    def of(
        cls, points: np.ndarray, fields: np.ndarray, *, tolerance: float, name: str = "T"
    ) -> FieldModes:
        """The smallest basis by singular values that has given fields up to a tolerance.

        Args:
            points: coordinates of the nodes, (n, dim), in the unit of the mesh.
            fields: given fields, (s, n).
            tolerance: largest error of their projections at any node, in the unit of the field.
            name: begin of the names of parameters.

        Raises:
            SceneError: for fields that are not finite or of another shape, fields of zeros alone,
                and a tolerance that is not positive.
        """
        if not name.isidentifier():
            raise SceneError(f"the name {name!r} of a field must be one of parameters, such as T")
        if np.ndim(fields) != 2 or np.shape(fields)[1] != len(points):
            raise SceneError(
                f"field modes need fields, (s, n), at n = {len(points)} points, and not of shape "
                f"{np.shape(fields)}: a row for each field"
            )
        values = [NodalField(points, values).values for values in fields]
        if not np.any(values):
            raise SceneError("field modes need a field or more that is not zero everywhere")
        if not tolerance > 0:
            raise SceneError(f"tolerance = {tolerance!r} of field modes must be positive")
        given = np.array(values)
        modes = np.linalg.svd(given, full_matrices=False)[2].T
        count = 1
        while count < modes.shape[1] and _left_out(modes[:, :count], given).max() > tolerance:
            count += 1
        modes = np.ascontiguousarray(modes[:, :count])
        amplitudes = given @ modes
        low = amplitudes.min(axis=0, initial=0.0)
        high = amplitudes.max(axis=0, initial=0.0)
        wider = WIDER * (high - low)
        known = NodalField(points, values[0]).points
        return cls(known, modes, low - wider, high + wider, name, float(tolerance))

    def __repr__(self) -> str:
        nodes, count = self.modes.shape
        return f"<{count} modes of fields {self.name} at {nodes} points>"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, (k,)."""
        return tuple(f"{self.name}{number}" for number in range(1, self.modes.shape[1] + 1))

    def joined(self, box: ParameterSpace | None = None) -> ParameterSpace:
        """A box with the amplitudes after its own parameters.

        Args:
            box: other parameters; None for none.
        """
        own = (self.names, tuple(self.lower.tolist()), tuple(self.upper.tolist()))
        if box is None:
            return ParameterSpace(*own)
        names, lower, upper = own
        return ParameterSpace((*box.names, *names), (*box.lower, *lower), (*box.upper, *upper))

    def expansion(self, tag: Tag, coefficient: float | str) -> tuple[ThermalExpansion, ...]:
        """Loads of a body by a field of temperatures above its stress-free one, (k,).

        Args:
            tag: cell tag of the body.
            coefficient: its coefficient of expansion, see :class:`ThermalExpansion`, which does
                not depend on temperature.

        Raises:
            SceneError: for a coefficient that names an amplitude.
        """
        from hhr_dolfinx.formulas import formula_of
        from hhr_dolfinx.plugins.volume_loads.loads import ThermalExpansion

        formula = formula_of(coefficient, f"the expansion of body {tag}")
        if named := sorted(set(formula.variables) & set(self.names)):
            raise SceneError(
                f"the expansion {coefficient!r} of body {tag} names {named[0]}, the amplitude of a "
                "mode and no temperature: a coefficient that depends on temperature is not linear "
                "in the field. Give the field of the strain instead of that of the temperature"
            )
        return tuple(
            ThermalExpansion(tag, formula, formula_of(name, name), NodalField(self.points, mode))
            for name, mode in zip(self.names, self.modes.T, strict=True)
        )

    def amplitudes(self, values: np.ndarray) -> dict[str, float]:
        """Amplitudes of a field by the names of their parameters.

        Args:
            values: values at the points, (n,).

        Raises:
            ParameterError: for values that are not finite, or of other points.

        Warns:
            OutsideTrainingWarning: of a field that the modes do not have up to their tolerance.
        """
        given = self._checked(values)
        error = float(_left_out(self.modes, given[None])[0])
        if error > self.tolerance:
            warn(
                f"modes of field {self.name} leave out {error:.3g} of it, more than "
                f"{self.tolerance:.3g} of given fields: give more fields like it to FieldModes.of",
                OutsideTrainingWarning,
            )
        return dict(zip(self.names, (given @ self.modes).tolist(), strict=True))

    def left_out(self, values: np.ndarray) -> np.ndarray:
        """Part of a field that the modes do not have, (n,).

        Args:
            values: values at the points, (n,).

        Raises:
            ParameterError: for values that are not finite, or of other points.
        """
        given = self._checked(values)
        return given - self.modes @ (given @ self.modes)

    def values(self, amplitudes: Mapping[str, float]) -> np.ndarray:
        """Field of amplitudes by the names of their parameters, (n,).

        Args:
            amplitudes: the amplitudes; names of other parameters have no effect.

        Raises:
            ParameterError: for a missing amplitude.
        """
        if missing := [name for name in self.names if name not in amplitudes]:
            raise ParameterError(f"amplitude {missing[0]} of field {self.name} is missing")
        return self.modes @ np.array([amplitudes[name] for name in self.names])

    def _checked(self, values: np.ndarray) -> np.ndarray:
        """Values at the points, (n,)."""
        given = np.asarray(values, dtype=float)
        if given.shape != self.points.shape[:1]:
            raise ParameterError(
                f"a field {self.name} has {len(self.points)} values, one for each point, and not "
                f"{given.shape}"
            )
        if not np.isfinite(given).all():
            raise ParameterError(f"a field {self.name} must have finite values")
        return given

    def save(self, path: str | Path) -> None:
        """Write the modes as one ``.npz`` file.

        Args:
            path: the file.
        """
        header = {
            "format": FIELD_MODES,
            "version": MODES_VERSION,
            "name": self.name,
            "tolerance": self.tolerance,
        }
        arrays = {name: getattr(self, name) for name in ("points", "modes", "lower", "upper")}
        write_arrays(path, header, arrays)

    @classmethod
    def load(cls, path: str | Path) -> FieldModes:
        """Read the modes of a file; nothing of it is executed.

        Args:
            path: the file.

        Raises:
            FileContentError: if it is damaged or no such file.
        """
        header, arrays = read_arrays(path, FIELD_MODES, MODES_VERSION)
        try:
            made = cls(**arrays, name=header["name"], tolerance=float(header["tolerance"]))
            fits = made.modes.shape == (len(made.points), made.lower.size)
            fits = fits and made.lower.shape == made.upper.shape and isinstance(made.name, str)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise FileContentError(f"{path} is no file of field modes: {error}") from error
        if not fits:
            raise FileContentError(f"{path} is no file of field modes: its arrays do not fit")
        return made

    def write_header(self, path: str | Path) -> None:
        """Write a C header, whose function projects a field on the modes.

        ``T_amplitudes(field, amplitudes)`` has ``T_NODES`` values and ``T_MODES`` amplitudes, which
        are parameters of ``hhr embed`` and of units.

        Args:
            path: the file.

        Raises:
            SceneError: for a name of the field that C does not have.
        """
        if not self.name.isidentifier() or not self.name.isascii():
            raise SceneError(f"the name {self.name!r} of a field is no name in C")
        nodes, count = self.modes.shape
        rows = ",\n".join("{" + ", ".join(map(repr, mode.tolist())) + "}" for mode in self.modes.T)
        text = PROJECTION.format(
            name=self.name, capitals=self.name.upper(), nodes=nodes, count=count, rows=rows
        )
        with replacing(path, text=True) as file:
            file.write(text)


PROJECTION = """/* Amplitudes of fields {name}, values at {nodes} nodes, on {count} modes. */
#ifndef {capitals}_FIELD_MODES_H
#define {capitals}_FIELD_MODES_H
#define {capitals}_NODES {nodes}
#define {capitals}_MODES {count}

static const double {name}_modes[{count}][{nodes}] = {{
{rows}
}};

static inline void {name}_amplitudes(const double *field, double *amplitudes)
{{
    for (int k = 0; k < {count}; k++) {{
        amplitudes[k] = 0.0;
        for (int i = 0; i < {nodes}; i++)
            amplitudes[k] += {name}_modes[k][i] * field[i];
    }}
}}
#endif
"""
"""Text of a C header."""


def _left_out(modes: np.ndarray, fields: np.ndarray) -> np.ndarray:
    """Largest value that modes, (n, k), leave out of each of some fields, (s, n)."""
    largest: np.ndarray = np.abs(fields - (fields @ modes) @ modes.T).max(axis=1)
    return largest
