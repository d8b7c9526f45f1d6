"""Chapter 1 of the thesis: snapshots that decay, rivals with dual bases, RID, and scenes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from interface import ExtendedInterface
from items import DISCS, PELLET, Cases, Item, Points, percent
from matplotlib.figure import Figure

from hhr_dolfinx.plugins.rivals.cones import greedy_cone, nonnegative_factors, touching
from hhr_dolfinx.plugins.rivals.projection import (
    ConeModel,
    displacement_modes,
    with_supremizers,
)

RANKS = 5, 10, 20, 40, 60
"""Ranks of figure 1.9."""
DUAL_MODES = 20
"""Functions of rivals' dual bases."""
AT = (170.0, 3.2)
"""Point of figure 1.12, that of figure 3.8."""


def items(cases: Cases) -> Iterator[Item]:
    """Items of the chapter."""
    for number, what in SKETCHES.items():
        yield Item(number, what, "a drawing")
    yield decay(cases)
    yield from rivals(cases)
    yield extended_interface(cases)
    yield from scenes(cases)


SKETCHES = {
    "figures 1.1 to 1.4": "reactor, fuel, cracks, coupling in PLEIADES",
    "figures 1.5 and 1.6": "contact problem, node to node and obstacle",
    "figures 1.7 and 1.8": "sampled mesh, clusters",
}


def decay(cases: Cases) -> Item:
    """Figure 1.9: how well bases of rank k approximate displacements and forces."""
    snapshots = cases.pellet.snapshots
    ranks = [rank for rank in RANKS if rank <= min(snapshots.forces.shape) // 2]
    lines = {
        "displacements, SVD": _tails(snapshots.displacements, ranks),
        "forces, SVD": _tails(snapshots.forces, ranks),
        "forces, NNMF": [_not_spanned(snapshots.forces, rank) for rank in ranks],
    }
    figure = Figure(figsize=(5, 3.4), layout="constrained")
    axis = figure.subplots()
    for label, errors in lines.items():
        axis.semilogy(ranks, errors, ".-", label=label)
    axis.set(xlabel="rank", ylabel="relative error", title="figure 1.9, pellet")
    axis.legend()
    figure.savefig(cases.folder / "figure_1_9.png", dpi=300)
    last = {label: errors[-1] for label, errors in lines.items()}
    return Item(
        "figure 1.9",
        "decay of snapshots",
        "another scene's picture: forces decay far more slowly than displacements, NNMF worse "
        "than SVD",
        f"pellet at rank {ranks[-1]}: "
        + ", ".join(f"{label} {value:.1e}" for label, value in last.items()),
        "forces have no basis: those of the RID are kept",
        "the picture is of Fauque et al. 2018",
    )


def _tails(columns: np.ndarray, ranks: list[int]) -> list[float]:
    """Relative errors of the best bases of some ranks, in the Frobenius norm."""
    squares = np.linalg.svd(columns, compute_uv=False) ** 2
    return [float(np.sqrt(squares[rank:].sum() / squares.sum())) for rank in ranks]


def _not_spanned(forces: np.ndarray, rank: int) -> float:
    """Relative error of a basis of non-negative factors, with non-negative coefficients."""
    from scipy.optimize import nnls

    basis = nonnegative_factors(forces, rank)
    off = [nnls(basis, column)[1] for column in forces.T]
    return float(np.linalg.norm(off) / np.linalg.norm(forces))


def rivals(cases: Cases) -> Iterator[Item]:
    """Figures 1.10 to 1.12: models with dual bases."""
    training = cases.pellet
    full, snapshots = training.full_order, training.snapshots
    count = min(DUAL_MODES, snapshots.forces.shape[0] // 2)
    modes = displacement_modes(snapshots, 12 if cases.quick else 30)
    by_factors, by_cone = (
        ConeModel(full, with_supremizers(full, modes, cone), cone)
        for cone in (
            nonnegative_factors(snapshots.forces, count),
            greedy_cone(touching(snapshots), count),
        )
    )
    exact = full.solve(AT).forces()

    def off(model: Any) -> float:
        forces = model.solve(AT).forces()
        return float(np.linalg.norm(forces - exact) / np.linalg.norm(exact))

    theirs, ours = off(by_factors), off(cases.pellet_usual)
    yield Item(
        "figures 1.10 and 1.12",
        "forces by a dual basis of NNMF, beside HHR",
        "pictures: NNMF misses the peaks, HHR does not",
        f"pellet at (170 MPa, 3.2 mm): {count} factors of NNMF, {percent(theirs)} off",
        f"HHR {percent(ours)} off",
        "pictures of Balajewicz et al. 2016 and Fauque et al. 2018, of other scenes",
        PELLET,
    )
    drawn = snapshots.points[:: max(1, len(snapshots.points) // 60)]
    fresh = training.full_order.parameters.random(len(drawn), cases.seed + 11)
    inside, outside = (
        float(np.median(Points.of(training, points, iter).errors(by_cone).primal))
        for points in (drawn, fresh)
    )
    yield Item(
        "figure 1.11",
        "CPG in and outside of its training",
        "a picture: larger errors outside",
        f"displacement of {count} cone functions, median: {percent(inside)} in training, "
        f"{percent(outside)} outside",
        reason="the picture is of Kollepara et al. 2023, H1 norm, another scene",
        command=PELLET,
    )


def extended_interface(cases: Cases) -> Item:
    """Figure 1.13: the interface extended by Dirichlet, or a larger RID."""
    training, model = cases.pellet, cases.pellet_model(4e-4, None, 1.0)
    extended = ExtendedInterface.of(training, model)
    points = Points.of(training, training.full_order.parameters.random(60, cases.seed + 5), iter)
    pairs = zip(points.points, points.forces, strict=True)
    errors = np.array([extended.error(*pair) for pair in pairs])[points.pressed]
    closed = points.errors(model).rid[points.pressed]
    alone = (
        f", forces in the RID {percent(np.median(errors))} in the median"
        if extended.conditions
        else ": DEIM picks nodes of one side, whose partners are interface then"
    )
    return Item(
        "figure 1.13",
        "interface extended by Dirichlet (a), or gaps closed in the RID (b)",
        "a drawing; the thesis takes (b)",
        f"(a): {extended.conditions} of {extended.of_closed} conditions are left{alone}",
        f"(b): {extended.of_closed} conditions, forces in the RID {percent(np.median(closed))} in "
        "the median",
        "the same nodes and modes, a function of each contact node; the code has (b)",
    )


def scenes(cases: Cases) -> Iterator[Item]:
    """Figures 1.14 and 1.15: sizes of the scenes."""
    discs, pellet = (training.full_order.problem for training in (cases.discs, cases.pellet))
    yield Item(
        "figure 1.14",
        "half-discs",
        "N = 1356, N_lambda = 55, 1214 cells",
        f"N = {discs.free.size}, N_lambda = {len(discs.gaps)}, {len(discs.cell_nodes)} cells",
        command=DISCS,
    )
    sides = pellet.pressing_of(0).size
    yield Item(
        "figure 1.15",
        "pellet and cladding",
        "N = 14140, N_lambda = 101",
        f"N = {pellet.free.size}, {sides} conditions on the side, "
        f"{len(pellet.gaps) - sides} below the pellet",
        reason="the pellet may lift off its support, a second contact (section 1.5.2)",
        command=PELLET,
    )
