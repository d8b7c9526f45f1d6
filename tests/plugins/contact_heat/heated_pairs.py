"""Scenes of two blocks with heat between them, and a coupled full model of its own.

The reference shares nothing with the package but the nodes and cells of the mesh: bilinear cells by
Gauss' rule, heat and displacement one after another until neither changes, contact by its statuses.
"""

import itertools

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import spsolve

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side

YOUNG = {FIRST: 200.0, SECOND: 70.0}
POISSON = {FIRST: 0.3, SECOND: 0.2}
CONDUCTIVITY = {FIRST: 20.0, SECOND: 50.0}
CAPACITY = {FIRST: 3.0, SECOND: 2.0}
EXPANSION = {FIRST: 2.3e-5, SECOND: 1.2e-5}
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(4)
GAUSS = [
    ((1 + POINTS[i]) / 2, (1 + POINTS[j]) / 2, WEIGHTS[i] * WEIGHTS[j] / 4)
    for i, j in itertools.product(range(POINTS.size), repeat=2)
]


def bowed(points, tag):
    """The upper block touches in the middle."""
    moved = points.copy()
    if tag == SECOND:
        moved[:, 1] += 0.016 * (points[:, 0] - 1.5) ** 2 * (2 - points[:, 1])
    return moved


def blocks(hypothesis="plane_strain", cells=6, **more):
    """The upper block is pushed down by ``push`` and as warm as ``T`` on top."""
    faces = side(FIRST, 1, True), side(SECOND, 1, False)
    n = (cells, cells)
    return hhr.Scene(
        name="warm_blocks",
        geometry=lambda comm: two_blocks.two_blocks(
            comm, warp=bowed, first=((1.0, 0.0), (2.0, 1.0), n), second=((1.0, 1.0), (2.0, 2.0), n)
        ),
        hypothesis=hypothesis,
        bodies=tuple(hhr.Body(tag, YOUNG[tag], POISSON[tag]) for tag in (FIRST, SECOND)),
        contacts=(hhr.NodeToNode(*faces, (0.0, 1.0)),),
        parameters=hhr.ParameterSpace(("push", "T"), (0.002, 20.0), (0.01, 150.0)),
        displacements=(
            *hhr.Displacement.clamp(side(FIRST, 1, False), 2),
            hhr.Displacement(side(SECOND, 1, True), 0),
            hhr.Displacement(side(SECOND, 1, True), 1, hhr.Amplitude(slopes={"push": -1.0})),
        ),
        outputs=(
            hhr.LargestPressure("peak", 0),
            hhr.DisplacementAt("corner", (2.0, 1.0), 0, FIRST),
        ),
        **more,
    )


def thick_blocks(thickness, cells=6):
    """The same in space, of one cell across, held between two planes."""
    n = (cells, 1, cells)
    low, high = (1.0, 0.0, 0.0), (2.0, thickness, 1.0)

    def warp(points, tag):
        moved = points.copy()
        moved[:, [0, 2]] = bowed(points[:, [0, 2]], tag)
        return moved

    planes = [side(tag, 1, upper) for tag in (FIRST, SECOND) for upper in (False, True)]
    top = side(SECOND, 2, True)
    return hhr.Scene(
        name="thick_blocks",
        geometry=lambda comm: two_blocks.two_blocks(
            comm,
            warp=warp,
            first=(low, high, n),
            second=((1.0, 0.0, 1.0), (2.0, thickness, 2.0), n),
        ),
        hypothesis="solid",
        bodies=blocks().bodies,
        contacts=(hhr.NodeToNode(side(FIRST, 2, True), side(SECOND, 2, False), (0.0, 0.0, 1.0)),),
        parameters=blocks().parameters,
        displacements=(
            *hhr.Displacement.clamp(side(FIRST, 2, False), 3),
            *(hhr.Displacement(plane, 1) for plane in planes),
            hhr.Displacement(top, 0),
            hhr.Displacement(top, 1),
            hhr.Displacement(top, 2, hhr.Amplitude(slopes={"push": -1.0})),
        ),
    )


def thick_heat():
    fixed = ((side(FIRST, 2, False), 5.0), (side(SECOND, 2, True), "T"))
    return heat(temperatures=[hhr.FixedTemperature(*pair) for pair in fixed])


def rod_scene(gap=0.0, cells=(2, 2), order=1, pairing=None, **more):
    """Two rods between walls that hold them aside: nothing depends on the place across."""
    faces = side(FIRST, 1, True), side(SECOND, 1, False)
    sides = [side(tag, 0, upper) for tag in (FIRST, SECOND) for upper in (False, True)]
    push = hhr.Amplitude(slopes={"push": -1.0})
    given = {
        "name": "rods",
        "geometry": lambda comm: two_blocks.two_blocks(
            comm,
            first=((0.0, 0.0), (1.0, 1.0), (cells[0], 4)),
            second=((0.0, 1.0 + gap), (1.0, 2.0 + gap), (cells[1], 4)),
        ),
        "hypothesis": "plane_strain",
        "bodies": (hhr.Body(FIRST, 200.0, 0.0), hhr.Body(SECOND, 100.0, 0.0)),
        "contacts": (pairing(*faces) if pairing else hhr.NodeToNode(*faces, (0.0, 1.0)),),
        "parameters": hhr.ParameterSpace(("push", "T"), (-0.01, -200.0), (0.01, 200.0)),
        "displacements": (
            hhr.Displacement(side(FIRST, 1, False), 1),
            *(hhr.Displacement(tag, 0) for tag in sides),
            hhr.Displacement(side(SECOND, 1, True), 1, push),
        ),
        "outputs": (hhr.LargestPressure("peak", 0),),
        "order": order,
    }
    return hhr.Scene(**given | more)


CONDUCTANCE = "30 * p / (p + 0.5) + 0.05 / (g + 0.001)"


def conducted(pressure, gap):
    return 30 * pressure / (pressure + 0.5) + 0.05 / (gap + 0.001)


def heat(**more):
    given = {
        "conductivity": CONDUCTIVITY,
        "conductance": {0: CONDUCTANCE},
        "capacity": CAPACITY,
        "expansion": EXPANSION,
        "reference": 10.0,
        "temperatures": [
            hhr.FixedTemperature(side(FIRST, 1, False), 5.0),
            hhr.FixedTemperature(side(SECOND, 1, True), "T"),
        ],
    }
    return hhr.Heat(**given | more)


SLIDING = {0: hhr.SlidingHeat("0.2 + T / 1e3", "1e3 * x", 0.8)}
FED = {
    "temperatures": [hhr.FixedTemperature(side(FIRST, 1, False), "T / 5")],
    "supplies": [
        hhr.HeatSource(SECOND, "table(T, 0, 0, 100, 200, 200, 300) + 1e3 * push"),
        hhr.Convection(side(SECOND, 1, True), 0.1, 20.0),
    ],
}
GIVEN = [
    ("plane_strain", {}),
    ("axisymmetric", FED),
    # the upper block is fed by its source and contact alone
    ("plane_strain", {**FED, "supplies": FED["supplies"][:1]}),
    ("plane_strain", {**FED, "supplies": FED["supplies"][:1], "sliding": SLIDING}),
    ("plane_strain", {"conductance": {}, "sliding": SLIDING}),
]
"""Hypotheses and arguments of heat that C and pages are asked for."""


def _shapes(a, b):
    """Bilinear functions and their slopes, nodes in the order of DOLFINx."""
    values = np.array([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b])
    slopes = np.array([[b - 1, a - 1], [1 - b, -a], [-b, 1 - a], [b, a]])
    return values, slopes


class Coupled:
    """Coupled full model of the two blocks."""

    def __init__(self, problem, hypothesis):
        self.points = problem.points
        self.cells = problem.cell_nodes
        self._round = hypothesis == "axisymmetric"
        middles = self.points[self.cells].mean(axis=1)
        self.tags = np.where(middles[:, 1] < 1.0, FIRST, SECOND)
        self._assemble()
        n = len(self.points)
        low = [k for k in range(n) if k in set(self.cells[self.tags == FIRST].ravel())]
        on_low = [k for k in low if abs(self.points[k, 1] - 1) < 1e-9]
        high = sorted(set(range(n)) - set(low))
        nearest = {
            k: min(high, key=lambda j: np.hypot(*(self.points[j] - self.points[k]))) for k in on_low
        }
        self.pairs = np.array([(k, nearest[k]) for k in on_low])
        self.gaps = self.points[self.pairs[:, 1], 1] - self.points[self.pairs[:, 0], 1]
        self.areas = self._areas([k for k, _ in self.pairs])
        self.bottom = np.flatnonzero(np.abs(self.points[:, 1]) < 1e-9)
        self.top = np.flatnonzero(np.abs(self.points[:, 1] - 2) < 1e-9)

    def _assemble(self):
        n = len(self.points)
        entries = {"k": [], "t": [], "c": [], "m": []}
        for cell, tag in zip(self.cells, self.tags, strict=True):
            young, nu = YOUNG[tag], POISSON[tag]
            lam, mu = young * nu / (1 + nu) / (1 - 2 * nu), young / 2 / (1 + nu)
            d = lam * np.outer([1, 1, 1, 0], [1, 1, 1, 0]) + np.diag([2 * mu, 2 * mu, 2 * mu, mu])
            beta = (3 * lam + 2 * mu) * EXPANSION[tag]
            dofs = np.column_stack([2 * cell, 2 * cell + 1]).ravel()
            for a, b, weight in GAUSS:
                values, slopes = _shapes(a, b)
                jacobian = slopes.T @ self.points[cell]
                g = slopes @ np.linalg.inv(jacobian).T
                radius = values @ self.points[cell, 0]
                w = (
                    abs(np.linalg.det(jacobian))
                    * weight
                    * (2 * np.pi * radius if self._round else 1)
                )
                strain = np.zeros((4, 8))
                strain[0, ::2], strain[1, 1::2] = g[:, 0], g[:, 1]
                strain[3, ::2], strain[3, 1::2] = g[:, 1], g[:, 0]
                if self._round:
                    strain[2, ::2] = values / radius
                entries["k"].append((dofs, dofs, w * strain.T @ d @ strain))
                stored = w * CAPACITY[tag] * np.outer(values, values)
                entries["m"].append((cell, cell, stored))
                entries["t"].append((cell, cell, w * CONDUCTIVITY[tag] * g @ g.T))
                volume = np.array([1, 1, 1, 0]) @ strain
                entries["c"].append((dofs, cell, w * beta * np.outer(volume, values)))
        self.stiffness = _summed(entries["k"], (2 * n, 2 * n))
        self.conductivity = _summed(entries["t"], (n, n))
        self.capacity = _summed(entries["m"], (n, n))
        self.expansion = _summed(entries["c"], (2 * n, n))

    def _areas(self, nodes):
        x = self.points[nodes, 0]
        order = np.argsort(x)
        areas = np.zeros(len(x))
        for first, second in itertools.pairwise(order):
            wide = x[second] - x[first]
            for a in (0.5 - 12**-0.5, 0.5 + 12**-0.5):
                place = x[first] + a * wide
                weight = wide / 2 * (2 * np.pi * place if self._round else 1)
                areas[first] += (1 - a) * weight
                areas[second] += a * weight
        return areas

    def solve(self, push, warm, rounds=400):
        """Forces and heat flows from the lower to the upper block."""
        return self._settled(push, warm, 0 * self.capacity, np.zeros(len(self.points)), rounds)

    def march(self, pushes, warms, times, start):
        """The same at the ends of implicit steps from a temperature of all nodes."""
        temperature = np.full(len(self.points), start)
        found = []
        for push, warm, length in zip(pushes, warms, np.diff(times, prepend=0.0), strict=True):
            stored = self.capacity / length
            found.append(self._settled(push, warm, stored, stored @ temperature))
            temperature = found[-1][2]
        return found

    def _settled(self, push, warm, stored, before, rounds=400):
        m = len(self.pairs)
        forces, gaps = np.zeros(m), self.gaps.copy()
        for _ in range(rounds):
            h = self.areas * conducted(np.maximum(forces, 0) / self.areas, np.maximum(gaps, 0))
            temperature, flows = self._heated(h, warm, stored, before)
            new, gaps = self._touching(temperature - 10.0, push)
            if np.abs(new - forces).max() <= 1e-14 * np.abs(new).max():
                return new, flows, temperature
            forces = (forces + new) / 2
        raise AssertionError("the reference does not settle")

    def _heated(self, h, warm, stored, before):
        n, m = len(self.points), len(self.pairs)
        rows = np.arange(m)
        jump = coo_matrix(
            (np.r_[np.ones(m), -np.ones(m)], (np.r_[rows, rows], self.pairs.T.ravel())), (m, n)
        ).tocsr()
        matrix = self.conductivity + jump.T @ csr_matrix(np.diag(h)) @ jump + stored
        temperature = np.zeros(n)
        temperature[self.bottom], temperature[self.top] = 5.0, warm
        free = np.setdiff1d(np.arange(n), np.r_[self.bottom, self.top])
        heat = (before - matrix @ temperature)[free]
        temperature[free] = spsolve(matrix[free][:, free], heat)
        return temperature, h * (jump @ temperature)

    def _touching(self, warmth, push):
        u = np.zeros(2 * len(self.points))
        u[2 * self.top + 1] = -push
        held = np.r_[2 * self.bottom, 2 * self.bottom + 1, 2 * self.top, 2 * self.top + 1]
        free = np.setdiff1d(np.arange(u.size), held)
        load = self.expansion @ warmth - self.stiffness @ u
        low, high = 2 * self.pairs[:, 0] + 1, 2 * self.pairs[:, 1] + 1
        closed = np.ones(len(self.pairs), dtype=bool)
        for _ in range(50):
            rows = np.zeros((closed.sum(), u.size))
            rows[np.arange(closed.sum()), low[closed]] = 1.0
            rows[np.arange(closed.sum()), high[closed]] = -1.0
            k = self.stiffness[free][:, free].toarray()
            b = rows[:, free]
            block = np.block([[k, b.T], [b, np.zeros((len(b), len(b)))]])
            right = np.r_[load[free], self.gaps[closed] - rows @ u]
            found = np.linalg.solve(block, right)
            whole = u.copy()
            whole[free] = found[: free.size]
            forces = np.zeros(closed.size)
            forces[closed] = found[free.size :]
            gaps = self.gaps - whole[low] + whole[high]
            wrong = (closed & (forces < 0)) | (~closed & (gaps < 0))
            if not wrong.any():
                return forces, gaps
            closed ^= wrong
        raise AssertionError("contact does not settle")


def _summed(entries, shape):
    rows = np.concatenate([np.repeat(r, len(c)) for r, c, _ in entries])
    columns = np.concatenate([np.tile(c, len(r)) for r, c, _ in entries])
    return coo_matrix(
        (np.concatenate([block.ravel() for *_, block in entries]), (rows, columns)), shape
    ).tocsr()
