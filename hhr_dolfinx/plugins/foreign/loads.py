"""Load vectors that another code has written: thermal loads, gravity, or anything that its elements
integrate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.amplitudes import Amplitude, check_amplitude
from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import FileContentError, FileError, SceneError
from hhr_dolfinx.formulas import Formula
from hhr_dolfinx.plugins.foreign.dof_table import DIRECTIONS

if TYPE_CHECKING:
    from hhr_dolfinx.loads import Assembler, Load, Term
    from hhr_dolfinx.plugins.foreign.parts import Parts

Dofs = Mapping[tuple[int, int], float]


@dataclass(frozen=True)
class ForeignLoad(KnownArguments):
    """Forces on dofs of a block by their labels, for the amplitude 1.

    Attributes:
        forces: forces by ``(label, direction)``, directions 1 to 6, or a file with lines ``label
            direction force`` (``*MATRIX OUTPUT, LOAD`` of Abaqus), blanks or commas between.
        amplitude: a number, an Amplitude, or a formula of the parameters as text.
        block: name of the block; empty for the only one.
    """

    forces: str | Path | Dofs
    amplitude: Amplitude | Formula = Amplitude(1.0)
    block: str = ""

    def __post_init__(self) -> None:
        check_amplitude(self, f"the foreign load {self.forces!r}", formulas=True)
        if isinstance(self.forces, Mapping):
            _check_forces(self.forces, "a foreign load")

    def terms(self, assembler: Assembler) -> list[Term]:
        """Refuse: only the discretisation of blocks knows their labels.

        Raises:
            SceneError: always.
        """
        raise SceneError(
            "a ForeignLoad is one of a block of another code: give it to foreign.scene(...)"
        )

    def vector(self, parts: Parts) -> np.ndarray:
        """Forces on all dofs of the blocks, (N,).

        Raises:
            SceneError: for an unknown block, or a dof that its K lacks.
        """
        names = [block.name for block in parts.blocks]
        if self.block not in names and (self.block or len(names) > 1):
            raise SceneError(
                f"a foreign load is of block {self.block!r}, and there are {', '.join(names)}: "
                "name one"
            )
        number = names.index(self.block) if self.block else 0
        forces = self.forces if isinstance(self.forces, Mapping) else read_load(Path(self.forces))
        _check_forces(forces, "a foreign load" if forces is self.forces else str(self.forces))
        nodes = parts.made[number].nodes
        turning = parts.made[number].turning
        index = {int(label): k for k, label in enumerate(nodes.labels)}
        vector = np.zeros(3 * len(parts.points))
        for (label, direction), value in forces.items():
            node = index.get(label, -1)
            node = int(turning[node]) if node >= 0 and direction > 3 else node
            if node < 0:
                raise SceneError(
                    f"a foreign load acts on dof {label}.{direction}, which K of block "
                    f"'{names[number]}' lacks"
                )
            vector[3 * (int(parts.firsts[number]) + node) + (direction - 1) % 3] += value
        return vector


def _check_forces(forces: Dofs, what: str) -> None:
    """Raise SceneError for no force, for directions beyond 1 to 6, and for values without size."""
    if not forces:
        raise SceneError(f"{what} has no force: give {{(label, direction): force}}")
    for (label, direction), value in forces.items():
        if direction not in range(1, 7):
            raise SceneError(
                f"{what} acts on dof {label}.{direction}: directions are 1 to 3 for forces and 4 "
                "to 6 for moments, as in the other code"
            )
        if not np.isfinite(value):
            raise SceneError(f"{what} is {value} at dof {label}.{direction}: it must be finite")


def vector_of(load: Load, parts: Parts) -> np.ndarray | None:
    """Forces of a load on all dofs for the amplitude 1, (N,).

    None for a load that needs an assembler.

    A force on a node that several nodes stand for is shared by those that carry it. Pressures and
    tractions act on the faces of the elements, with their shape functions.

    Args:
        load: load of the scene.
        parts: blocks of the scene.

    Raises:
        SceneError: for a nodal force that has not three components.
    """
    if isinstance(load, ForeignLoad):
        return load.vector(parts)
    # the others need UFL to be made
    from hhr_dolfinx.loads import Pressure, Traction
    from hhr_dolfinx.plugins.nodal_loads.loads import NodalForce

    if isinstance(load, Pressure | Traction):
        along = None if isinstance(load, Pressure) else np.array(load.direction, dtype=float)
        return parts.faces(load.tag).forces(parts.points, along).ravel()
    if isinstance(load, NodalForce):
        if len(load.vector) != 3:
            raise SceneError(
                f"the nodal force {load.vector} at {load.place!r} must have three components"
            )
        nodes = parts.nodes(load.place)
        forces = np.zeros((len(parts.points), 3))
        forces[nodes] = parts.shares(nodes)[:, None] * np.array(load.vector)
        return forces.ravel()
    return None


def read_load(path: Path) -> dict[tuple[int, int], float]:
    """Forces by label and direction of a file with lines ``label direction force``.

    Raises:
        FileError: without the file.
        FileContentError: for a line of another form.
    """
    if not path.is_file():
        raise FileError(f"there is no load vector {path}")
    forces: dict[tuple[int, int], float] = {}
    for number, line in enumerate(
        path.read_text(encoding="utf-8", errors="replace").splitlines(), start=1
    ):
        words = line.replace(",", " ").split()
        if not words or words[0][0] in "*#%!":
            continue
        try:
            key = int(words[0]), DIRECTIONS[words[1].upper()]
            forces[key] = forces.get(key, 0.0) + float(words[2])
        except (ValueError, IndexError, KeyError):
            raise FileContentError(
                f"{path.name}:{number} '{line}' is no force: label direction force"
            ) from None
    return forces
