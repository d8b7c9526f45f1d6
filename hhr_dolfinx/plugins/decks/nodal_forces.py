"""Different forces at many nodes, with one amplitude."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hhr_dolfinx.amplitudes import Amplitude, check_amplitude
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import Formula
from hhr_dolfinx.loads import Assembler, Term
from hhr_dolfinx.plugins.nodal_loads.loads import NodalForce


@dataclass(frozen=True)
class NodalForces:
    """Forces ``amplitude(mu) * vector`` at the nodes of several sets, as one load: those of a
    ``*CLOAD`` block.

    Attributes:
        vectors: the force at each node of a set, (dim,), by the name of the set.
        amplitude: a number, an Amplitude, or a formula of the parameters as text.
    """

    vectors: Mapping[str, tuple[float, ...]]
    amplitude: Amplitude | Formula = Amplitude(1.0)

    def __post_init__(self) -> None:
        if not isinstance(self.vectors, Mapping) or not self.vectors:
            raise SceneError(
                f"vectors = {self.vectors!r} must be forces by the name of a set: {{'tip': (0.0, "
                "-1.0)}"
            )
        check_amplitude(self, f"nodal forces at {len(self.vectors)} sets", formulas=True)

    def terms(self, assembler: Assembler) -> list[Term]:
        """One vector, the sum of all sets."""
        columns = [
            NodalForce(node_set, vector).terms(assembler)[0].columns
            for node_set, vector in self.vectors.items()
        ]
        return [Term(self.amplitude, sum(columns[1:], columns[0]))]
