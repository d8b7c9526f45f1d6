"""Condensation of blocks of other codes without a scene: no DOLFINx, PETSc or mesh. A superelement
needs no factor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.contact.rows import ContactRows, joined
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.formulas import Formula
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.pairings import Pairing
from hhr_dolfinx.parameters import ParameterSpace, Place, Tag
from hhr_dolfinx.plugins.foreign.loads import vector_of
from hhr_dolfinx.plugins.foreign.parts import Blocks, Parts
from hhr_dolfinx.plugins.tables.matrices import condense_matrices

if TYPE_CHECKING:
    from hhr_dolfinx.loads import Pressure, Traction
    from hhr_dolfinx.plugins.foreign.loads import ForeignLoad
    from hhr_dolfinx.plugins.nodal_loads.loads import NodalForce
    from hhr_dolfinx.scene import Displacement, Opening


def condense_blocks(
    foreign: Blocks,
    parameters: ParameterSpace,
    contacts: Sequence[Pairing],
    *,
    displacements: Sequence[tuple[Tag | Place, int] | Displacement] = (),
    loads: Sequence[ForeignLoad | NodalForce | Pressure | Traction] = (),
    openings: Sequence[tuple[int, Amplitude | Formula | str | float] | Opening] = (),
    outputs: Mapping[str, tuple[Tag | Place, int]] | None = None,
) -> CondensedModel:
    """Condense blocks of other codes; the model has forces of each contact as outputs, ``force 0
    x``.

    Args:
        foreign: blocks, each with a solved case, with constant factors.
        parameters: box of the parameters.
        contacts: contact pairs without laws.
        displacements: pairs of a set or place and a component, 3 to 5 of rotations, that are held
            at zero, or each a :class:`~hhr_dolfinx.scene.Displacement`.
        loads: load vectors of other codes, :class:`ForeignLoad`; with UFL nodal forces, pressures
            and tractions too.
        openings: pairs of the index of a contact and an amplitude, or each an
            :class:`~hhr_dolfinx.scene.Opening`.
        outputs: mean displacements by name: a set of nodes or a place, and a component.

    Raises:
        NotOfferedError: for what needs a scene: friction, factors that vary, other loads, blocks
            without a case.
        SceneError: for displacements that are not zero, and conditions or loads on dofs that K
            lacks.
        NotSolvableError: for a K that is not positive definite.
    """
    _check(foreign, contacts)
    parts = Parts(foreign.blocks)
    parts.compare()
    held = _held(parts, displacements)
    free = np.flatnonzero(parts.known & ~held)
    surfaces: list[list[Any]] = [
        [parts.surface(tag) for tag in pairing.tags] for pairing in contacts
    ]
    rows_of_pairs = [
        pairing.rows(on_surfaces, held.size)
        for pairing, on_surfaces in zip(contacts, surfaces, strict=True)
    ]
    rows = joined(rows_of_pairs)
    pairs = np.repeat(
        np.arange(len(rows_of_pairs)), [len(rows_of_pair.gap) for rows_of_pair in rows_of_pairs]
    )
    idle = np.flatnonzero(np.diff(csr_matrix(rows.matrix[:, free]).indptr) == 0)
    if idle.size:
        raise SceneError(
            f"{idle.size} conditions of contact {pairs[idle[0]]} act on held dofs alone: leave "
            "held nodes out of its surface"
        )
    columns, gaps, amplitudes = _terms(parts, loads, openings, rows, pairs)
    _check_known(parts, held, rows, columns)
    factors = [float(Formula(block.formula)({})) for block in foreign.blocks]
    stiffness = sum(factor * matrix for factor, matrix in zip(factors, parts.matrices, strict=True))
    return condense_matrices(
        parameters,
        csr_matrix(stiffness)[free][:, free],
        rows.matrix[:, free],
        columns[free],
        gaps,
        amplitudes,
        areas=rows.areas,
        pairs=pairs,
        displacement_outputs=_means(parts, outputs or {}, free),
        force_outputs=_resultants(parts, contacts, rows, pairs),
    )


def _check(foreign: Blocks, contacts: Sequence[Pairing]) -> None:
    """Raise NotOfferedError for what needs a scene."""
    scene = "make a scene of it, foreign.scene(...), and condense that, hhr.condense(scene)"
    if foreign.unchecked:
        raise NotOfferedError(
            f"blocks {', '.join(foreign.unchecked)} have no solved case, which answers must say: "
            f"{scene}"
        )
    if any(block.variables for block in foreign.blocks):
        raise NotOfferedError(f"a block has a factor that varies: {scene}")
    if any(
        getattr(pairing, "friction", None) is not None or getattr(pairing, "law", None) is not None
        for pairing in contacts
    ):
        raise NotOfferedError(f"a contact has friction or another law: {scene}")


def _check_known(parts: Parts, held: np.ndarray, rows: ContactRows, columns: np.ndarray) -> None:
    """Raise SceneError for contact or loads on dofs that K lacks, and that nothing holds."""
    unknown = ~parts.known & ~held
    for acting, sizes in (
        ("contact", abs(rows.matrix).max(axis=0).toarray().ravel()),
        ("a load", abs(columns).max(axis=1)),
    ):
        if (lost := np.flatnonzero((sizes > 0) & unknown)).size:
            raise SceneError(
                f"{acting} acts on {parts.described(lost[0])}, which K does not have: retain this "
                "dof"
            )


def _held(
    parts: Parts, displacements: Sequence[tuple[Tag | Place, int] | Displacement]
) -> np.ndarray:
    """Dofs that displacements hold, (N,) bool."""
    held = np.zeros(3 * len(parts.points), dtype=bool)
    for displacement in displacements:
        tag, component = (
            displacement
            if isinstance(displacement, tuple)
            else (displacement.tag, displacement.component)
        )
        if not isinstance(displacement, tuple) and displacement.amplitude != Amplitude():
            raise SceneError(f"{displacement!r} is not zero: make a scene, foreign.scene(...)")
        nodes = parts.nodes(tag)
        if component > 2:
            nodes = parts.turning(nodes)
            component = component - 3
        held[3 * nodes + component] = True
    return held


def _terms(
    parts: Parts,
    loads: Sequence[ForeignLoad | NodalForce | Pressure | Traction],
    openings: Sequence[tuple[int, Amplitude | Formula | str | float] | Opening],
    rows: ContactRows,
    pairs: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, list[Amplitude | str | float]]:
    """Loads, (N, T), gaps, (m, T), and their amplitudes, the first of which is 1 and has the gaps
    of the mesh.
    """
    columns = [np.zeros(3 * len(parts.points))]
    gaps = [rows.gap]
    amplitudes: list[Amplitude | str | float] = [1.0]
    for load in loads:
        vector = vector_of(load, parts)
        if vector is None:
            raise NotOfferedError(
                f"{load!r} needs a scene: give nodal forces, pressures, tractions or a ForeignLoad"
            )
        columns.append(vector)
        gaps.append(np.zeros(pairs.size))
        amplitudes.append(_amplitude(load.amplitude))
    for opening in openings:
        columns.append(np.zeros(3 * len(parts.points)))
        contact, amplitude = (
            opening if isinstance(opening, tuple) else (opening.contact, opening.amplitude)
        )
        gaps.append((pairs == contact).astype(float))
        amplitudes.append(_amplitude(amplitude))
    return np.column_stack(columns), np.column_stack(gaps), amplitudes


def _amplitude(given: Amplitude | Formula | str | float) -> Amplitude | str | float:
    """An amplitude as :func:`condense_matrices` takes it."""
    return given.text if isinstance(given, Formula) else given


def _means(
    parts: Parts, outputs: Mapping[str, tuple[Tag | Place, int]], free: np.ndarray
) -> dict[str, np.ndarray]:
    """Rows of mean displacements on free dofs, by name."""
    means = {}
    for name, (tag, component) in outputs.items():
        nodes = parts.nodes(tag)
        row = np.zeros(3 * len(parts.points))
        row[3 * nodes + component] = 1.0 / nodes.size
        means[name] = row[free]
    return means


def _resultants(
    parts: Parts, contacts: Sequence[Pairing], rows: ContactRows, pairs: np.ndarray
) -> dict[str, np.ndarray]:
    """Weights of forces whose sums are the resultants on the body of the first surface, by name."""
    weights = {}
    for number, pairing in enumerate(contacts):
        nodes = parts.surface(pairing.tags[0]).nodes
        for component, axis in enumerate("xyz"):
            sums = np.asarray(-rows.matrix[:, 3 * nodes + component].sum(axis=1)).ravel()
            weights[f"force {number} {axis}"] = np.where(pairs == number, sums, 0.0)
    return weights
