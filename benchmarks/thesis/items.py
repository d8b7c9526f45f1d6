"""What ``side_by_side.py`` compares: items of the thesis, its scenes, and their errors.

Scenes are trained once, when a chapter first asks for them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import hertz_half_discs
import numpy as np
import pellet_cladding
import pellet_cladding_nonmatching
from mpi4py import MPI
from pellet_cladding_tables import thesis

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import force_floor
from hhr_dolfinx.models.answer import Model
from hhr_dolfinx.plugins.studies.measure import conditions_inside
from hhr_dolfinx.plugins.studies.points import time_queries
from hhr_dolfinx.study.training.train import Training

RIGHT_OF_GRAZING = 40.0
"""Pressure P1 in MPa from which contact does not graze: the thesis' maps are dark below."""
WRONG = 0.1
"""Relative error of forces above which a point of a map counts as wrong."""
DISCS = "python benchmarks/thesis/hertz_half_discs.py"
PELLET = "python benchmarks/thesis/pellet_cladding.py --study thesis"
NONMATCHING = "python benchmarks/thesis/pellet_cladding_nonmatching.py"
PLASTIC = "python benchmarks/thesis/pellet_cladding_plastic.py"
CERTIFIED = "python benchmarks/certified.py"
LOCAL = "python benchmarks/local_models.py"


@dataclass(frozen=True)
class Item:
    """A figure or table of the thesis beside what this code finds.

    Attributes:
        number: as printed, ``figure 3.5``.
        what: what it shows, in a few words.
        printed: what can be read off it.
        as_printed: the same, by the steps that the thesis names.
        ours: the same, by default.
        reason: why these differ; empty if they do not.
        command: what shows more of it; empty for ``make thesis`` alone.
    """

    number: str
    what: str
    printed: str
    as_printed: str = ""
    ours: str = ""
    reason: str = ""
    command: str = ""

    def row(self) -> dict[str, str]:
        """Texts by name."""
        return asdict(self)


class Maps(NamedTuple):
    """Relative errors of forces over points, (n,), infinite without an answer."""

    rid: np.ndarray  #: on the conditions of the RID, (3.7)
    whole: np.ndarray  #: on the whole surface
    primal: np.ndarray  #: of displacements, (3.6)


@dataclass(frozen=True)
class Points:
    """Full answers at points of the box.

    Attributes:
        points: points, (n, P).
        displacements: displacements, (n, N).
        forces: contact forces, (n, N_lambda).
        floor: force below which a relative error means nothing.
    """

    points: np.ndarray
    displacements: np.ndarray
    forces: np.ndarray
    floor: float

    @classmethod
    def of(cls, training: Training, points: np.ndarray, progress: Any) -> Points:
        """Solve the full model at points, (n, P)."""
        full = training.full_order
        answers = [full.solve(point) for point in progress(points)]
        return cls(
            points,
            np.stack([answer.displacement() for answer in answers]),
            np.stack([answer.forces() for answer in answers]),
            force_floor(full.problem, training.snapshots),
        )

    def errors(self, model: Model) -> Maps:
        """Errors of a model at all points."""
        found = np.full((3, len(self.points)), np.inf)
        for number, point in enumerate(self.points):
            answer = model.solve(point, outside="ignore", raise_on_failure=False)
            if not answer.converged:
                continue
            exact, forces = self.forces[number], answer.forces()
            found[1, number] = self._off(forces, exact)
            inside = conditions_inside(answer.fields)
            found[0, number] = (
                found[1, number] if inside is None else self._off(answer.multipliers, exact[inside])
            )
            found[2, number] = _relative(answer.displacement(), self.displacements[number])
        return Maps(*found)

    def _off(self, forces: np.ndarray, exact: np.ndarray) -> float:
        """Error of forces; points without contact, where both are below the floor, are right."""
        return float(np.linalg.norm(forces - exact) / max(np.linalg.norm(exact), self.floor))

    @property
    def pressed(self) -> np.ndarray:
        """Points right of those where contact grazes, (n,) bool."""
        return self.points[:, 0] >= RIGHT_OF_GRAZING


def _relative(answer: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(answer - exact) / np.linalg.norm(exact))


@dataclass(frozen=True)
class Cases:
    """Scenes of the thesis, trained as there.

    Attributes:
        folder: where pictures and tables go.
        quick: coarse meshes and few points.
        progress: bar of a label.
        seed: of random points.
    """

    folder: Path
    quick: bool
    progress: Callable[[str], Any]
    seed: int = 1
    built: dict[str, Model] = field(default_factory=dict)

    @property
    def mesh(self) -> dict[str, Any]:
        """Options of the pellet's mesh."""
        return pellet_cladding.QUICK_MESH if self.quick else {}

    @property
    def grid(self) -> tuple[int, int]:
        """Training answers of the pellet along both parameters."""
        return (8, 6) if self.quick else pellet_cladding.GRID

    def _trained(self, scene: hhr.Scene, training: Sequence[int]) -> Training:
        bar = self.progress
        return hhr.train(scene, training, held_out=0, comm=MPI.COMM_SELF, progress=bar)

    @cached_property
    def discs(self) -> Training:
        """Half-discs, section 1.5.1: 31 answers."""
        return self._trained(hertz_half_discs.scene(), [31])

    @cached_property
    def pellet(self) -> Training:
        """Pellet, section 1.5.2: 500 answers on a regular grid."""
        return self._trained(pellet_cladding.scene(**self.mesh), self.grid)

    @cached_property
    def nonmatching(self) -> Training:
        """Pellet on meshes that do not match, section 5.3: 500 answers."""
        mesh = {**self.mesh, "cladding_axial_cells": 15} if self.quick else {}
        return self._trained(pellet_cladding_nonmatching.scene(**mesh), self.grid)

    def validation(self, training: Training, label: str) -> Points:
        """Full answers at 3100 regular points (62 x 50), as the thesis' maps have."""
        counts = [9, 7] if self.quick else [62, 50]
        points = training.full_order.parameters.grid(counts)
        return Points.of(training, points, self.progress(f"{label}, {len(points)} points"))

    @cached_property
    def pellet_points(self) -> Points:
        """Full answers of the pellet at 3100 points."""
        return self.validation(self.pellet, "pellet")

    @cached_property
    def nonmatching_points(self) -> Points:
        """Full answers of the pellet on meshes that do not match, at 3100 points."""
        return self.validation(self.nonmatching, "meshes that do not match")

    def pellet_model(
        self, dual: float, extended: float | None = None, kappa_max: float = 10.0
    ) -> Model:
        """Model of the pellet by the thesis' recipe, see :func:`pellet_cladding_tables.thesis`."""
        name = f"{dual} {extended} {kappa_max}"
        if name not in self.built:
            recipe = thesis(extended, dual, kappa_max)
            self.built[name] = self.pellet.build(recipe, checked=False)
        return self.built[name]

    @cached_property
    def pellet_usual(self) -> Model:
        """Model of the pellet by default."""
        return self.pellet.build(checked=False)


def sizes(model: Any) -> str:
    """Modes before and after enrichment, and contact conditions of the RID."""
    enrichment = model.offline.enrichment
    modes = enrichment.basis.shape[1]
    return (
        f"ell = {modes - len(enrichment.added)}, N_C = {len(model.fields.A_lambda)}, "
        f"ell_bar = {modes}"
    )


def of_map(errors: np.ndarray, points: Points) -> str:
    """A map in words, where contact does not graze: median, and shares that are wrong or lost."""
    there = errors[points.pressed]
    lost = np.mean(~np.isfinite(there))
    silent = f", {lost:.1%} without an answer" if lost else ""
    return (
        f"median {percent(np.median(there))}, {np.mean(there > WRONG):.0%} of points above "
        f"{WRONG:.0%}{silent}"
    )


def percent(value: float) -> str:
    """A share in per cent with two digits."""
    return f"{100 * value:.2g} %" if np.isfinite(value) else "no answer"


def milliseconds(models: dict[str, Model], points: np.ndarray) -> dict[str, float]:
    """Median time of an answer of each model in turns, in ms."""
    times = time_queries({name: model.solve for name, model in models.items()}, points)
    return {name: 1e3 * float(np.median(seconds)) for name, seconds in times.items()}
