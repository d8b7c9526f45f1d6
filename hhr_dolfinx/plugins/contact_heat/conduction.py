"""Heat in the bodies of a scene, eliminated down to heat flows of contacts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from scipy.sparse import csc_matrix, csr_matrix, vstack
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from hhr_dolfinx import compat
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.forms.elasticity import volume_weight
from hhr_dolfinx.formulas import Formula, Scalar, formula_of
from hhr_dolfinx.plugins.contact_heat.heat import Convection, Heat, HeatFlux, HeatSource
from hhr_dolfinx.plugins.contact_heat.parts import Conduction

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from hhr_dolfinx.full_order.discretisation import Discretisation
    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.loads import Load


@dataclass(frozen=True, eq=False)
class HeatSystem:
    """Heat of a scene before it is eliminated: K_T T = loads - B_T^T q, with fixed T."""

    amplitudes: tuple[Scalar, ...]  #: of the supplies and fixed temperatures, (t,)
    stiffness: csr_matrix  #: K_T, conductivity and convection, (n, n)
    loads: np.ndarray  #: heat to each node per amplitude, (n, t)
    lifted: np.ndarray  #: fixed temperatures per amplitude, 0 elsewhere, (n, t)
    fixed: np.ndarray  #: nodes of fixed temperatures
    levels: np.ndarray  #: 1 in each body that contact alone feeds, (n, b); none of transient heat
    pins: np.ndarray  #: a node of each body that contact alone feeds, (b,)
    #: B_T, temperature of the first surface less that of the second, (m, n), and less that of both
    #: by the shares of the heat that conditions make which slide, (g, n)
    jumps: csr_matrix
    expansion: csr_matrix  #: C, nodal forces per temperature, (N, n)
    at_rest: np.ndarray  #: nodal forces of the reference temperatures, (N,)
    capacity: csr_matrix  #: M_T, heat per rise of the temperature, (n, n); 0 of steady heat


def heat_system(
    full: FullOrderModel, heat: Heat, conducts: Sequence[int], *, transient: bool = False
) -> HeatSystem:
    """Assemble the heat of a scene.

    Args:
        full: the full model of the scene, on one rank.
        heat: its heat.
        conducts: numbers of the contacts that conduct anywhere.
        transient: bodies store heat, and need no other temperature than that of their start.

    Raises:
        SceneError: for unknown tags, a body without a conductivity, or, of transient heat, without
            a capacity; of steady heat for a body to which no temperature is given.
    """
    assembly = _Assembly(full, heat)
    stiffness, loads, amplitudes = assembly.heat()
    fixed, values, of_fixed = _fixed(full.discretisation, heat)
    jumps = jumps_of(full)
    conducting = jumps[np.isin(full.problem.contact_pairs, list(conducts))]
    jumps = csr_matrix(vstack([jumps, _falls_of_sliding(full, jumps, heat)]))
    if transient:  # all bodies have the temperature of their start
        levels = np.zeros((stiffness.shape[0], 0))
        pins = np.zeros(0, dtype=int)
    else:
        levels, pins = _levels(stiffness, fixed, assembly.cooled, conducting)
    expansion, at_rest = assembly.expansion()
    names = full.parameters.names
    return HeatSystem(
        amplitudes=tuple(Scalar(formula.text, names) for formula in (*amplitudes, *of_fixed)),
        stiffness=stiffness,
        loads=np.hstack([loads, np.zeros_like(values)]),
        lifted=np.hstack([np.zeros_like(loads), values]),
        fixed=fixed,
        levels=levels,
        pins=pins,
        jumps=jumps,
        expansion=expansion,
        at_rest=at_rest,
        capacity=assembly.capacity() if transient else csr_matrix(stiffness.shape),
    )


def eliminated(system: HeatSystem) -> Conduction:
    """Factor K_T, and solve it for all supplies and heat flows.

    Args:
        system: heat of a scene.
    """
    held = np.ones(len(system.lifted), dtype=bool)
    held[system.fixed] = held[system.pins] = False
    factor = splu(csc_matrix(system.stiffness[held][:, held]))
    temperatures = system.lifted.copy()
    temperatures[held] += factor.solve((system.loads - system.stiffness @ system.lifted)[held])
    per_heat = np.zeros((len(held), system.jumps.shape[0]))
    per_heat[held] = factor.solve(np.ascontiguousarray(system.jumps.T.toarray()[held]))
    return Conduction(
        amplitudes=system.amplitudes,
        temperatures=temperatures,
        per_heat=per_heat,
        levels=system.levels,
        jumps=csc_matrix(system.jumps),
        supplied=system.levels.T @ system.loads,
    )


def temperature_space(discretisation: Discretisation) -> tuple[fem.FunctionSpace, np.ndarray]:
    """Space of temperatures, and the node of each of its dofs, (n,).

    Args:
        discretisation: functions on the mesh of the scene.
    """
    space, parents = discretisation.space.sub(0).collapse()
    return space, np.ravel(parents).astype(np.int64) // discretisation.mesh.geometry.dim


def jumps_of(full: FullOrderModel) -> csr_matrix:
    """B_T, (m, n): weights of nodes as in B, without the normal, that sum up to 1 on the first
    surface of a contact.

    Args:
        full: the full model of the scene.

    Raises:
        NotOfferedError: for a pairing both ways, whose conditions have slaves on both surfaces.
    """
    problem = full.problem
    assert problem.whole_contact is not None
    whole = csr_matrix(problem.whole_contact)
    dim = problem.points.shape[1]
    firsts = [
        np.isin(np.arange(len(problem.points)), full.discretisation.surface(contact.tags[0]).nodes)
        for contact in full.scene.contacts
    ]
    rows: list[int] = []
    weights: list[float] = []
    columns: list[int] = []
    for row, (slave, pair) in enumerate(
        zip(problem.contact_slaves, problem.contact_pairs, strict=True)
    ):
        if not firsts[pair][slave]:
            raise NotOfferedError(
                f"contact {pair} of scene '{full.scene.name}' goes both ways, and heat through it "
                "would count twice: take hhr.Mortar or hhr.NodeToSurface"
            )
        entries = slice(whole.indptr[row], whole.indptr[row + 1])
        nodes, places = np.unique(whole.indices[entries] // dim, return_inverse=True)
        blocks = np.zeros((nodes.size, dim))
        np.add.at(blocks, (places, whole.indices[entries] % dim), whole.data[entries])
        total = blocks[firsts[pair][nodes]].sum(axis=0)
        rows += [row] * nodes.size
        weights += (blocks @ total / (total @ total)).tolist()
        columns += nodes.tolist()
    shape = (len(problem.contact_slaves), len(problem.points))
    return csr_matrix((weights, (rows, columns)), shape=shape)


def sliding_conditions(full: FullOrderModel, heat: Heat) -> np.ndarray:
    """Numbers of the conditions whose surfaces make heat as they slide, (g,).

    Args:
        full: the full model of the scene.
        heat: its heat.
    """
    assert full.problem.contact_pairs is not None
    return np.flatnonzero(np.isin(full.problem.contact_pairs, list(heat.sliding)))


def _falls_of_sliding(full: FullOrderModel, jumps: csr_matrix, heat: Heat) -> csr_matrix:
    """Less the temperatures of both surfaces by the shares of the heat of each condition that
    slides, (g, n): as a flow, heat enters both.
    """
    rows = sliding_conditions(full, heat)
    falls = csr_matrix(jumps[rows])
    firsts = {
        pair: full.discretisation.surface(full.scene.contacts[pair].tags[0]).nodes
        for pair in heat.sliding
    }
    for place, pair in enumerate(full.problem.contact_pairs[rows].tolist()):
        entries = slice(falls.indptr[place], falls.indptr[place + 1])
        first = np.isin(falls.indices[entries], firsts[pair])
        share = heat.sliding[pair].share
        falls.data[entries] *= np.where(first, -share, 1 - share)
    return falls


def _fixed(
    discretisation: Discretisation, heat: Heat
) -> tuple[np.ndarray, np.ndarray, list[Formula]]:
    """Nodes of fixed temperatures, their values per amplitude, (n, k), and the amplitudes.

    A node of several has the last.
    """
    count = discretisation.size // discretisation.mesh.geometry.dim
    values = np.zeros((count, len(heat.temperatures)))
    for column, item in enumerate(heat.temperatures):
        nodes = discretisation.nodes(item.tag)
        values[nodes] = 0.0
        values[nodes, column] = 1.0
    amplitudes = [formula_of(item.temperature, "a temperature") for item in heat.temperatures]
    return np.flatnonzero(values.any(axis=1)), values, amplitudes


def _levels(
    stiffness: csr_matrix, fixed: np.ndarray, cooled: np.ndarray, conducting: csr_matrix
) -> tuple[np.ndarray, np.ndarray]:
    """1 in each part of the mesh without fixed temperature and convection, (n, b), and one node of
    each, which is held instead of the level.

    Args:
        stiffness: K_T, (n, n).
        fixed: nodes of fixed temperatures.
        cooled: nodes with convection.
        conducting: rows of contacts that conduct, (k, n).

    Raises:
        SceneError: if no contact joins such a part to one whose temperature is determined.
    """
    count, owner = connected_components(stiffness, directed=False)
    held = np.unique(owner[np.concatenate([fixed, cooled]).astype(int)])
    joined = np.zeros((count, count))
    for row in conducting:
        parts = np.unique(owner[row.indices[np.abs(row.data) > 0]])
        joined[np.ix_(parts, parts)] = 1.0
    _, group = connected_components(joined, directed=False)
    lost = [part for part in range(count) if group[part] not in group[held]]
    if lost:
        raise SceneError(
            f"the temperature of {len(lost)} of {count} bodies is not determined: they have "
            "neither a fixed temperature nor convection, and no contact that conducts joins them "
            "to a body that has. Name one, or give their contact a conductance"
        )
    levels = np.column_stack(
        [
            np.zeros((len(owner), 0)),
            *(owner == part for part in range(count) if part not in held),
        ]
    )
    return levels, np.array([np.flatnonzero(column)[0] for column in levels.T], dtype=int)


class _Assembly:
    """Forms of heat on the mesh of a scene, in the order of its nodes."""

    def __init__(self, full: FullOrderModel, heat: Heat):
        discretisation = full.discretisation
        self._discretisation = discretisation
        self._cells = full.problem.cell_nodes
        self._heat = heat
        self._space, self._node = temperature_space(discretisation)
        self._weight = volume_weight(discretisation.mesh, discretisation.scene.hypothesis)
        self._bodies = {body.tag for body in discretisation.scene.bodies}
        self.cooled = np.zeros(0, dtype=np.int64)  #: nodes with convection

    def heat(self) -> tuple[csr_matrix, np.ndarray, list[Formula]]:
        """Conductivity matrix, (n, n), loads of the supplies, (n, k), and their amplitudes."""
        trial = ufl.TrialFunction(self._space)
        test = ufl.TestFunction(self._space)
        form = sum(
            (
                self._constant(value) * self._weight * ufl.inner(ufl.grad(trial), ufl.grad(test))
                * self._discretisation.cells(tag)
                for tag, value in self._of_bodies("conductivity")
            ),
            start=ufl.Form([]),
        )  # fmt: skip
        loads = []
        amplitudes = []
        for item in self._heat.supplies:
            ways = self._discretisation.assembler(cast("Load", item))  # which messages name
            measure = ways.dx(item.tag) if isinstance(item, HeatSource) else ways.ds(item.tag)
            factor = 1.0
            if isinstance(item, Convection):
                factor = item.coefficient
                form += self._constant(factor) * self._weight * trial * test * measure
                self.cooled = np.union1d(self.cooled, self._discretisation.nodes(item.tag))
            vector = fem.assemble_vector(
                compat.jitted(fem.form, self._constant(factor) * self._weight * test * measure)
            ).array
            loads.append(self._ordered(vector))
            amplitudes.append(_amplitude_of(item))
        order = np.argsort(self._node)
        stiffness = self._matrix(form, len(order))[order][:, order]
        columns = np.column_stack([np.zeros((len(self._node), 0)), *loads])
        return stiffness, columns, amplitudes

    def capacity(self) -> csr_matrix:
        """Capacity matrix, (n, n).

        Raises:
            SceneError: for a body without a capacity, or an unknown one.
        """
        trial = ufl.TrialFunction(self._space)
        test = ufl.TestFunction(self._space)
        form = sum(
            (
                self._constant(value) * self._weight * trial * test
                * self._discretisation.cells(tag)
                for tag, value in self._of_bodies("capacity")
            ),
            start=ufl.Form([]),
        )  # fmt: skip
        order = np.argsort(self._node)
        return self._matrix(form, len(order))[order][:, order]

    def expansion(self) -> tuple[csr_matrix, np.ndarray]:
        """Nodal forces per temperature, (N, n), and those of the reference temperatures, (N,).

        Raises:
            SceneError: for a body whose moduli depend on parameters, or an unknown one.
        """
        discretisation = self._discretisation
        field = fem.Function(self._space)
        unit = ufl.Identity(3)
        total = csr_matrix((discretisation.size, len(self._node)))
        at_rest = np.zeros(discretisation.size)

        def derivative(form: ufl.Form) -> csr_matrix:
            along = ufl.derivative(form, field, ufl.TrialFunction(self._space))
            return self._matrix(along, discretisation.size)[:, np.argsort(self._node)]

        bodies = [body.tag for body in discretisation.scene.bodies]
        averaged = dict(zip(bodies, discretisation.mean_dilatation, strict=True))
        for tag, value in self._heat.expansion.items():
            self._check(tag)
            strain = self._constant(value) * field * unit
            if averaged[tag]:  # the means of cells are numbers, which have no derivative
                parts = self._by_colours(tag, field, strain)
            else:
                parts = discretisation.elasticity.eigenstress(
                    discretisation, tag, strain, derivative
                )
            for modulus, matrix in parts:
                if modulus.variables:
                    raise SceneError(
                        f"the moduli of body {tag} depend on parameters: heat through contacts is "
                        "for constant ones"
                    )
                scaled = float(modulus({})) * matrix
                total = total + scaled
                at_rest -= self._heat.reference_of(tag) * np.asarray(scaled.sum(axis=1)).ravel()
        return total, at_rest

    def _by_colours(
        self, tag: Any, field: fem.Function, strain: Expr
    ) -> list[tuple[Formula, csr_matrix]]:
        """Nodal forces per temperature of a body, by temperatures of nodes so far apart that no
        node has two of them next to it.
        """
        discretisation = self._discretisation
        n = len(self._node)
        dim = discretisation.mesh.geometry.dim
        cells = self._cells
        touching = csr_matrix(
            (
                np.ones(cells.size),
                (np.repeat(np.arange(len(cells)), cells.shape[1]), cells.ravel()),
            ),
            shape=(len(cells), n),
        )
        beside = csr_matrix(touching.T @ touching)
        place = np.argsort(self._node)  # dof of each node
        total: list[tuple[Formula, csr_matrix]] = []
        for nodes in _colours(csr_matrix(beside @ beside)):
            field.x.array[:] = 0.0
            field.x.array[place[nodes]] = 1.0
            owner = np.full(n, -1)
            chosen = beside[:, nodes].tocoo()
            owner[chosen.row] = nodes[chosen.col]
            parts = discretisation.elasticity.eigenstress(
                discretisation, tag, strain, discretisation._assemble_vector
            )
            for number, (modulus, forces) in enumerate(parts):
                rows = np.flatnonzero(forces)
                entries = (forces[rows], (rows, owner[rows // dim]))
                column = csr_matrix(entries, shape=(forces.size, n))
                if number == len(total):
                    total.append((modulus, column))
                else:
                    total[number] = (modulus, total[number][1] + column)
        field.x.array[:] = 0.0
        return total

    def _of_bodies(self, name: str) -> Iterator[tuple[Any, float]]:
        """A property of each body.

        Args:
            name: of the property in :class:`Heat`.

        Raises:
            SceneError: for a body without one, or an unknown body.
        """
        given = getattr(self._heat, name)
        for tag in given:
            self._check(tag)
        for body in self._discretisation.scene.bodies:
            if body.tag not in given:
                raise SceneError(f"body {body.tag} needs a {name}: name it in Heat(...)")
            yield body.tag, given[body.tag]

    def _check(self, tag: Any) -> None:
        if tag not in self._bodies:
            raise SceneError(
                f"heat names a body {tag!r}, the bodies of the scene are {sorted(self._bodies)}"
            )

    def _constant(self, value: float) -> fem.Constant:
        return self._discretisation.constant(value)

    def _ordered(self, vector: np.ndarray) -> np.ndarray:
        ordered = np.zeros(len(self._node))
        ordered[self._node] = vector
        return ordered

    def _matrix(self, form: ufl.Form, rows: int) -> csr_matrix:
        """Matrix of a form whose trial function is a temperature, (rows, n), in DOLFINx' order."""
        matrix = fem_petsc.assemble_matrix(compat.jitted(fem.form, form))
        matrix.assemble()
        indptr, indices, data = matrix.getValuesCSR()
        matrix.destroy()
        return csr_matrix((data, indices, indptr), shape=(rows, len(self._node)))


def _colours(beside: csr_matrix) -> list[np.ndarray]:
    """Sets of nodes of which none is beside another one of its set, one node after another."""
    colour = np.full(beside.shape[0], -1)
    for node in range(beside.shape[0]):
        used = set(colour[beside.indices[beside.indptr[node] : beside.indptr[node + 1]]].tolist())
        colour[node] = next(k for k in range(len(used) + 1) if k not in used)
    return [np.flatnonzero(colour == k) for k in range(colour.max(initial=-1) + 1)]


def _amplitude_of(item: HeatFlux | HeatSource | Convection) -> Formula:
    if isinstance(item, HeatFlux):
        value = item.flux
    else:
        value = item.power if isinstance(item, HeatSource) else item.surroundings
    return formula_of(value, "a supply of heat")
