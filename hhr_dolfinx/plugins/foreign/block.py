"""A block of another code: its K, its nodes, and a case that it has solved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import SceneError, SceneWarning
from hhr_dolfinx.formulas import Formula
from hhr_dolfinx.parameters import is_number
from hhr_dolfinx.plugins.foreign.case import SolvedCase, compare_case, read_case
from hhr_dolfinx.plugins.foreign.matrix import ForeignMatrix, checked_matrix
from hhr_dolfinx.plugins.foreign.nodes import ForeignNodes, read_nodes
from hhr_dolfinx.plugins.foreign.placed import Placed, placed
from hhr_dolfinx.plugins.foreign.readers import read_stiffness
from hhr_dolfinx.warn import warn


@dataclass(frozen=True, eq=False)
class ForeignBlock(KnownArguments):
    """Stiffness of a part, written by another finite element code.

    Attributes:
        stiffness: file, see :func:`read_stiffness`, or a matrix.
        nodes: file of the nodes, surfaces and sets, see :func:`read_nodes`, or these.
        case: a load case that the other code has solved, its file, see :func:`read_case`, or its
            values. It is compared whenever the scene is built.
        results: ``.frd`` of CalculiX with the nodes of shells and beams, see :func:`read_nodes`;
            None for the file beside the deck.
        unchecked: True to go without a case; then the scene must have the output
            ``UncheckedStiffness``.
        name: name of the block, the tag of its body.
        factor: number or formula of the parameters that K is multiplied by, such as ``"young /
            210e3"``.
        dofs: table of dofs, for formats that do not name their rows.
        matrix: name of the matrix in a file of Nastran with several.
        surfaces: mesh files (STL, VTK) of further surfaces by name, whose points are matched by
            place.
        move: shift of the block, (3,).
    """

    stiffness: str | Path | ForeignMatrix
    nodes: str | Path | ForeignNodes
    case: str | Path | SolvedCase | None = None
    results: str | Path | None = None
    unchecked: bool = False
    name: str = "block"
    factor: str | float = 1.0
    dofs: str | Path | None = None
    matrix: str = ""
    surfaces: Mapping[str, str | Path] = field(default_factory=dict)
    move: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not isinstance(self.stiffness, str | Path | ForeignMatrix):
            raise SceneError(
                f"the stiffness {self.stiffness!r} of block '{self.name}' must be a file or a "
                "ForeignMatrix"
            )
        if not isinstance(self.name, str) or not self.name.isidentifier():
            raise SceneError(
                f"the name {self.name!r} of a block must be an identifier, such as plate"
            )
        if self.case is None and not self.unchecked:
            raise SceneError(
                f"block '{self.name}' has no solved case, case=...: no file format says whether "
                "sign, unit, order and "
                "constraints are those that you mean. Give one load case that the same code has "
                "solved, or say "
                "unchecked=True, which each answer repeats"
            )
        if not is_number(self.factor) and not isinstance(self.factor, str):
            raise SceneError(
                f"the factor {self.factor!r} of block '{self.name}' must be a number or a formula"
            )
        if np.shape(self.move) != (3,) or not np.isfinite(self.move).all():
            raise SceneError(
                f"the shift {self.move!r} of block '{self.name}' must have three finite numbers"
            )

    def __repr__(self) -> str:
        """Names of its files, and no arrays: ranks compare these words."""
        words = [
            str(argument) if isinstance(argument, str | Path) else type(argument).__name__
            for argument in (self.stiffness, self.nodes)
        ]
        words += [f"{name}={getattr(self, name)!r}" for name in ("name", "factor", "move")]
        return f"ForeignBlock({', '.join(words)})"

    @property
    def formula(self) -> str:
        """The factor as a formula."""
        return self.factor if isinstance(self.factor, str) else repr(float(self.factor))

    @property
    def variables(self) -> tuple[str, ...]:
        """Parameters in the factor."""
        return tuple(sorted(Formula(self.formula).variables))

    @cached_property
    def placed(self) -> Placed:
        """K on its nodes, compared with its solved case.

        Raises:
            FileError, FileContentError: for files that are not there, or damaged.
            SceneError: if the case differs.

        Warns:
            SceneWarning: without a case.
        """
        _ = self.difference
        return self.read[0]

    @cached_property
    def difference(self) -> float | None:
        """Largest difference from its solved case, by factors of its own K; None without a case.

        Raises:
            SceneError: if it is beyond the tolerance of the case.
        """
        block, case = self.read
        return None if case is None else compare_case(block, case, self.name)

    @cached_property
    def read(self) -> tuple[Placed, SolvedCase | None]:
        """K on its nodes, and its solved case, which is not compared yet; see :attr:`placed`."""
        stiffness = self.stiffness
        matrix = (
            checked_matrix(stiffness)
            if isinstance(stiffness, ForeignMatrix)
            else read_stiffness(stiffness, self.dofs, self.matrix)
        )
        nodes = (
            self.nodes
            if isinstance(self.nodes, ForeignNodes)
            else read_nodes(self.nodes, self.results)
        )
        if self.surfaces:
            nodes = nodes.with_surfaces(self.surfaces)
        block = placed(matrix, nodes.moved(self.move) if any(self.move) else nodes)
        if self.case is None:
            warn(
                f"block '{self.name}' is unchecked: nothing says that sign, unit, order of rows "
                "and constraints of "
                f"{matrix.source} are those that you mean. Give a solved case",
                SceneWarning,
            )
            return block, None
        return block, self.case if isinstance(self.case, SolvedCase) else read_case(self.case)
