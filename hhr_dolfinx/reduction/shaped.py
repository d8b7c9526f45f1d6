"""Reduced problems and outputs of bodies whose shape depends on parameters, offline.

From a full model, a basis and a RID: what assembles the reduced problem of any shape, and outputs that are prepared on
few shapes and interpolated between them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.problem import ContactProblem, ContactRows, IndexSets
from hhr_dolfinx.errors import ParameterError, ReductionError, SceneError, StabilityWarning
from hhr_dolfinx.models.eliminations.interpolation import Interpolant, grow
from hhr_dolfinx.models.eliminations.shaped import (
    CellProjection,
    ContactPatch,
    FixedCells,
    PlacedNodes,
    RidAssembly,
    RidBody,
    RidShape,
    SurfacePatch,
)
from hhr_dolfinx.models.functionals.cells import element_stiffness
from hhr_dolfinx.models.functionals.functional import Functional, ShapeFunctionals
from hhr_dolfinx.models.functionals.kinds import Mises, MovingMises
from hhr_dolfinx.models.functionals.shaped import ROWS, ReshapedFunctionals, Zone
from hhr_dolfinx.reduction.interpolate import GridSettings, grown
from hhr_dolfinx.reduction.projection import open_conditions
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.rid_arrays import ShapedArrays


AGREED = 1e-9
"""Largest difference between conditions of a patch and those of whole surfaces, relative to the largest."""
RINGS = (1, 2)
"""Rings of facets around what conditions touch, on the surface of their slaves and on others: normals are averaged
over one, and nodes may slide over the other."""


def rid_assembly(
    full: Any, basis: np.ndarray, sets: IndexSets, *, tolerance: float = 1e-10, budget: int = 200
) -> RidAssembly:
    """Build what maps a parameter to the reduced problem (5.23) of the shape there.

    Args:
        full: the full model of a scene whose shape depends on parameters.
        basis: V, (N, ell).
        sets: index sets of a closed RID.
        tolerance: wished surplus of the interpolated loads, relative to their size.
        budget: most shapes at which loads are assembled.

    Raises:
        SceneError: for a scene of one shape, or graded bodies.
        ReductionError: for a RID that is not closed, or a pairing that does not make the same conditions twice.

    Warns:
        StabilityWarning: if the loads are not as smooth as wished.
    """
    problem = full.problem
    arrays = full.rid_arrays()
    if open_conditions(problem, sets).size:
        raise ReductionError("the RID is not closed: build it with reduced_domain")
    inside = np.zeros(problem.free.size, dtype=bool)
    inside[sets.A] = True
    known = _known(arrays, problem)
    patches = [patch for pair in range(len(arrays.pairings)) for patch in _patches(arrays, problem, sets, pair, known)]
    cell_nodes = problem.cell_nodes[sets.cells]
    nodes = np.unique(np.concatenate([cell_nodes.ravel(), *(patch.nodes for patch in patches)]))
    numbers = np.full(len(problem.points), -1)
    numbers[nodes] = np.arange(nodes.size)
    dofs = (nodes[:, None] * problem.block_size + np.arange(problem.block_size)).ravel()
    fields = basis[dofs], problem.lifts[dofs].toarray(), np.flatnonzero(inside[dofs])
    moving, fixed = _bodies(arrays, problem, sets, numbers)
    return RidAssembly(
        hypothesis=arrays.hypothesis,
        names=arrays.names,
        reference=arrays.reference[nodes],
        free=problem.free.reshape(-1, problem.block_size)[nodes],
        middles=arrays.middles.among(nodes),
        shapes=tuple(
            RidShape(shape, numbers[np.intersect1d(own, nodes, assume_unique=True)]) for shape, own in arrays.shapes
        ),
        rule=arrays.rule,
        bodies=tuple(body for body in moving if len(body.cells)),
        fixed=_projected(arrays, arrays.reference[nodes], [body for body in fixed if len(body.cells)], *fields),
        basis=fields[0],
        lifts=fields[1],
        tested=fields[2],
        patches=tuple(patch.renumbered(numbers) for patch in patches),
        openings=arrays.openings[sets.A_lambda],
        pairs=problem.contact_pairs[sets.A_lambda],
        forces=_forces(arrays, problem, basis[sets.A], sets.A, tolerance, budget),
    )


def _bodies(
    arrays: ShapedArrays, problem: ContactProblem, sets: IndexSets, numbers: np.ndarray
) -> tuple[list[RidBody], list[RidBody]]:
    """Cells of the RID that shapes move, and those that they leave where they are, by body."""
    moved = np.zeros(len(problem.points), dtype=bool)
    for _, nodes in arrays.shapes:
        moved[nodes] = True
    moving: list[RidBody] = []
    fixed: list[RidBody] = []
    for body in arrays.bodies:
        cells = problem.cell_nodes[np.intersect1d(body.cells, sets.cells)]
        moves = moved[cells].any(axis=1)
        for found, which in ((moving, moves), (fixed, ~moves)):
            found.append(RidBody(numbers[cells[which]], body.volume, body.shape, body.mean_dilatation))
    return moving, fixed


def _projected(
    arrays: ShapedArrays,
    points: np.ndarray,
    bodies: list[RidBody],
    basis: np.ndarray,
    lifts: np.ndarray,
    tested: np.ndarray,
) -> FixedCells:
    """What cells that do not move add to K~, by parts."""
    moduli = []
    ell = basis.shape[1]
    stiffness = np.zeros((2 * len(bodies), ell, ell))
    lifted = np.zeros((2 * len(bodies), ell, lifts.shape[1]))
    for place, body in enumerate(bodies):
        projection = CellProjection.of(body.cells, basis, lifts, tested, points.shape[1])
        for k, (modulus, weights) in enumerate(((body.volume, (1.0, 0.0)), (body.shape, (0.0, 1.0)))):
            corners = points[body.cells]
            cells = element_stiffness(corners, arrays.rule, arrays.hypothesis, *weights, body.mean_dilatation)
            projection.add(cells, stiffness[2 * place + k], lifted[2 * place + k])
            moduli.append(modulus)
    return FixedCells(tuple(moduli), stiffness, lifted)


def _forces(
    arrays: ShapedArrays, problem: ContactProblem, test: np.ndarray, inner: np.ndarray, tolerance: float, budget: int
) -> Interpolant:
    """V[A]^T F[A], (ell (1 + T),), over the parameters of shapes."""
    middle = problem.middle
    axes = arrays.axes

    def tested(place: np.ndarray) -> np.ndarray:
        point = middle.copy()
        point[axes] = place
        return np.asarray(test.T @ arrays.forces(point)[inner]).ravel()

    first = tested(middle[axes])
    size = float(np.linalg.norm(first))
    if size == 0:
        none = np.zeros(0)
        return Interpolant(
            none.astype(int), none, none, np.zeros((1, 0), dtype=int), np.zeros((first.size, 1)), np.ones((1, 1))
        )
    lower, upper = (np.array(ends, dtype=float)[axes] for ends in (problem.parameters.lower, problem.parameters.upper))
    grown = grow(tested, lambda values: float(np.linalg.norm(values)) / size, (axes, lower, upper), tolerance, budget)
    if grown.surplus > tolerance:
        warn(
            f"loads that move with the shape were assembled at {grown.evaluations} shapes and are still off by about "
            f"{grown.surplus:.1e} of their size: narrow the box, or raise the budget",
            StabilityWarning,
            stacklevel=3,
        )
    return grown.interpolant


class _Known(NamedTuple):
    """Conditions of whole surfaces at one point.

    Attributes:
        placed: the nodes.
        rows: conditions of all pairs.
        pairs: pair of each.
    """

    placed: PlacedNodes
    rows: ContactRows
    pairs: np.ndarray

    def of(self, pair: int) -> ContactRows:
        """Conditions of one pair."""
        return self.rows.take(np.flatnonzero(self.pairs == pair))


def _known(arrays: ShapedArrays, problem: ContactProblem) -> list[_Known]:
    """Conditions in the middle of the box and at two ends."""
    space = problem.parameters
    free = problem.free.reshape(-1, problem.block_size)
    found = []
    for point in (problem.middle, np.array(space.lower, dtype=float), np.array(space.upper, dtype=float)):
        placed = PlacedNodes.at(arrays.coordinates(point), arrays.hypothesis, free)
        found.append(_Known(placed, *arrays.rows(point)))
    return found


def _patches(
    arrays: ShapedArrays, problem: ContactProblem, sets: IndexSets, pair: int, known: list[_Known]
) -> Iterator[ContactPatch]:
    """The part of a contact pair around its conditions in the RID; none where it has none."""
    places = np.flatnonzero(problem.contact_pairs[sets.A_lambda] == pair)
    if not places.size:
        return
    slaves = problem.contact_slaves[sets.A_lambda[places]]
    if np.unique(slaves).size < slaves.size:
        raise ReductionError(f"the contact {arrays.pairings[pair]} has several conditions at one slave: not built in")
    for surfaces in _candidates(arrays.surfaces[pair], known[0].of(pair), slaves, problem.block_size):
        patch = ContactPatch(arrays.pairings[pair], surfaces, slaves, places)
        if all(_agrees(patch, item.placed, item.of(pair)) for item in known):
            yield patch
            return
    raise ReductionError(
        f"the contact {arrays.pairings[pair]} makes other conditions of its surfaces as arrays than in the full model"
    )


def _agrees(patch: ContactPatch, placed: PlacedNodes, whole: ContactRows) -> bool:
    """Whether a patch makes the conditions of whole surfaces."""
    place = np.full(len(placed.points), -1)
    place[whole.slaves] = np.arange(len(whole.slaves))
    if (place[patch.slaves] < 0).any():
        return True  # the shape changes what is in contact there: the full model refuses it
    try:
        found, kept = patch.found(placed)
    except ParameterError:
        return False
    there = whole.take(place[patch.slaves])
    apart = abs(found.matrix[kept] - there.matrix).max()
    size = np.ptp(there.points, axis=0).max(initial=0.0) + np.abs(there.gap).max()
    return bool(
        apart <= AGREED * abs(there.matrix).max() and np.abs(found.gap[kept] - there.gap).max() <= AGREED * size
    )


def _candidates(
    whole: tuple[SurfacePatch, ...], base: ContactRows, slaves: np.ndarray, dim: int
) -> Iterator[tuple[SurfacePatch, ...]]:
    """Parts of surfaces that may do for the conditions of some slaves, the smallest first.

    After rings around what conditions touch comes what matching meshes want, just the facets that face those of the
    slaves, and last the whole surfaces.
    """
    touched = _touched(base, slaves, dim)
    yield tuple(_around(part, touched, RINGS[not np.isin(slaves, part.facets).all()]) for part in whole)
    first = next((part for part in whole if np.isin(slaves, part.facets).all()), whole[0])
    near = np.unique(_around(first, np.isin(np.arange(touched.size), slaves), 1).facets)
    facing = _touched(base, near, dim)
    facing[near] = True
    yield tuple(_part(part, facing[part.facets].all(axis=1)) for part in whole)
    yield whole


def _touched(base: ContactRows, slaves: np.ndarray, dim: int) -> np.ndarray:
    """Nodes that the conditions of some slaves touch, a mask."""
    found = np.zeros(base.matrix.shape[1] // dim, dtype=bool)
    found[slaves] = True
    rows: csr_matrix = base.matrix[np.isin(base.slaves, slaves)]
    found[np.unique(rows.indices // dim)] = True
    return found


def _around(whole: SurfacePatch, nodes: np.ndarray, rings: int) -> SurfacePatch:
    """Facets of a surface that touch some nodes, a mask, and rings of others around them."""
    for _ in range(rings):
        more = np.zeros_like(nodes)
        more[whole.facets[nodes[whole.facets].any(axis=1)]] = True
        nodes = more
    return _part(whole, nodes[whole.facets].any(axis=1))


def _part(whole: SurfacePatch, chosen: np.ndarray) -> SurfacePatch:
    """Some facets of a surface, by a mask, with the nodes where it goes on beyond them."""
    edge = np.intersect1d(whole.facets[chosen], whole.facets[~chosen])
    return SurfacePatch(whole.tag, whole.facets[chosen], whole.behind[chosen], edge)


TOLERANCE = 3e-7
"""Wished error of the arrays of outputs, relative to their size: forces and displacements cancel in them, as in a gap,
and a grid so fine has a few shapes more than that of the model."""
_OF_ROWS = {item.name for item in fields(Functional)}


def reshaped_functionals(
    prepared: ShapeFunctionals, problem: ContactProblem, basis: np.ndarray, settings: GridSettings
) -> ReshapedFunctionals:
    """Outputs for displacements that are a basis, (N, ell), times coordinates and the lift.

    Strain is not interpolated: its cells are moved, see :mod:`hhr_dolfinx.models.functionals.cells`.

    Args:
        prepared: outputs of the full model.
        problem: its contact problem.
        basis: V.
        settings: how far the sparse grid grows.

    Raises:
        SceneError: for an output that is made of other conditions, or of arrays of other lengths, on other shapes.
    """
    lifted = np.flatnonzero(np.diff(problem.lifts.indptr)).astype(np.int64)
    columns = np.column_stack([basis, problem.lifts[:, lifted].toarray()])
    base = prepared.at(problem.middle).items

    def solved(point: np.ndarray) -> dict[str, np.ndarray]:
        found = {}
        for place, item in enumerate(prepared.at(point).items):
            _check_alike(base[place], item)
            for name, array in _arrays(item, columns).items():
                found[f"{place} {name}"] = array
        return found

    axes = np.array(problem.reshaped.axes, dtype=np.int64)
    finer = replace(settings, tolerance=min(TOLERANCE, settings.tolerance))
    grid, modes = grown(solved, problem.parameters, axes, finer)
    arrays: list[tuple[int, str, tuple[int, ...]]] = []
    for name, part in modes.items():
        place, own = name.split(" ", 1)
        arrays.append((int(place), own, part.shape[:-1]))
    items = []
    zones = []
    for item in base:
        zones.append(Zone(item.cells, columns[item.cells.dofs]) if isinstance(item, MovingMises) else None)
        items.append(_without_rows(item))
    return ReshapedFunctionals(
        items=tuple(items),
        arrays=tuple(arrays),
        interpolant=grid.interpolant,
        zones=tuple(zones),
        lifted=lifted,
        amplitudes=problem.amplitudes,
        parameters=problem.parameters,
    )


def _own(item: Functional) -> dict[str, Any]:
    """What an output has beside its rows."""
    return {field.name: getattr(item, field.name) for field in fields(item) if field.name not in _OF_ROWS | {"cells"}}


def _smooth(value: Any) -> bool:
    """Whether a field is interpolated."""
    return isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype == np.float64)


def _arrays(item: Functional, columns: np.ndarray) -> dict[str, np.ndarray]:
    """What of an output is interpolated, by name."""
    found = {name: np.asarray(value) for name, value in _own(item).items() if _smooth(value) and np.size(value)}
    if not isinstance(item, MovingMises) and item.count:
        found[ROWS] = item.matrix(len(columns)) @ columns
    return found


def _check_alike(base: Functional, item: Functional) -> None:
    """Raise SceneError for outputs of two shapes that differ by more than numbers."""
    if type(base) is type(item) and base.count == item.count:
        pairs = [(value, getattr(item, name)) for name, value in _own(base).items()]
        if all(np.shape(a) == np.shape(b) if _smooth(a) else np.array_equal(a, b) for a, b in pairs):
            return
    raise SceneError(
        f"output '{base.name}' is made of other conditions, terms or cells on another shape, and cannot be "
        "interpolated between shapes: narrow the box, or leave it out"
    )


def _without_rows(item: Functional) -> Functional:
    """An output whose rows are made elsewhere."""
    nowhere = np.zeros(0, dtype=np.int64)
    if isinstance(item, MovingMises):
        own = {field.name: getattr(item, field.name) for field in fields(Mises)}
        item = Mises(**own)
    return replace(item, rows=nowhere, columns=nowhere, entries=np.zeros(0))
