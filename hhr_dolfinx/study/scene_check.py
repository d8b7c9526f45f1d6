"""A look at a scene before anything is solved: what is in the mesh, what faces what, what moves, what does nothing."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.sparse import csc_matrix

from hhr_dolfinx.contact.problem import ContactProblem, ContactRows
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.full_order.motions import described, free_bodies
from hhr_dolfinx.pairings.surface import Surface
from hhr_dolfinx.scene import Scene

OK, NOTE, MISTAKE = "ok", "note", "mistake"
BAD_CELL = 0.1
"""Scaled Jacobian of a cell below which it is told of."""
TOUCHING = 1e-6
"""Gaps below so many times the sag of facets are none: bodies are drawn in touch."""
SMALL_GAP = 1.0
"""Gaps below so many times the sag of facets are made by the mesh rather than by the bodies."""


@dataclass(frozen=True)
class Finding:
    """One sentence about a scene.

    Attributes:
        level: ``ok``, ``note`` or ``mistake``.
        text: what was found, and what to do.
    """

    level: str
    text: str


@dataclass
class SceneCheck:
    """What was found.

    Attributes:
        scene: the scene.
        findings: in the order of the look.
        discretisation: its mesh; None where there is none.
        pairs: surfaces and rows of each contact pair; no rows where they were refused.
    """

    scene: Scene
    findings: list[Finding] = field(default_factory=list)
    discretisation: Discretisation | None = None
    pairs: list[tuple[list[Surface], ContactRows | None]] = field(default_factory=list)

    @property
    def mistakes(self) -> list[Finding]:
        """Those that keep the scene from being solved, or from meaning anything."""
        return [finding for finding in self.findings if finding.level == MISTAKE]

    @property
    def drawable(self) -> bool:
        """Whether there is a mesh to draw."""
        return self.discretisation is not None

    def draw(self, path: Path) -> None:
        """A picture of bodies, contact surfaces, supports and loads."""
        from hhr_dolfinx.study.scene_picture import draw_scene

        draw_scene(self, path)

    def say(self, level: str, text: str) -> None:
        """Add a finding."""
        self.findings.append(Finding(level, text))

    @contextmanager
    def heard(self) -> Iterator[None]:
        """Warnings of a block become notes, errors mistakes."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                yield
            except HHRError as error:
                self.say(MISTAKE, str(error))
        for item in caught:
            if issubclass(item.category, UserWarning):
                self.say(NOTE, str(item.message))


def check_scene(scene: Scene, point: Any = None) -> SceneCheck:
    """Look at a scene at a parameter, or in the middle of its box; nothing is factored or solved."""
    found = SceneCheck(scene)
    with found.heard():
        found.discretisation = Discretisation(scene, MPI.COMM_SELF)
    if found.discretisation is None:
        return found
    space = scene.parameters
    middle = np.mean([space.lower, space.upper], axis=0) if point is None else space.point(point)
    _bodies(found)
    _names(found)
    _pairs(found)
    if found.mistakes:
        return found
    problem = None
    with found.heard():
        problem = _problem(found.discretisation)
    if problem is not None:
        _gaps(found, problem, middle)
        with found.heard():
            _supports(found, problem)
        _loads(found)
    return found


def _problem(discretisation: Discretisation) -> ContactProblem:
    """The problem, whose stiffness is assembled; where bodies flow by the Gauss points that they have in any case."""
    if any(body.law is not None for body in discretisation.scene.bodies):
        from hhr_dolfinx.full_order.flow import GaussModel

        gauss = GaussModel.of(discretisation.scene, MPI.COMM_SELF)
        return discretisation.checked(discretisation.contact_problem(gauss.stiffness, gauss.moduli))
    return discretisation.checked(discretisation.contact_problem(*discretisation.stiffness_terms()))


def _length(scene: Scene) -> str:
    return "" if scene.units is None else f" {scene.units.length}"


def _bodies(found: SceneCheck) -> None:
    """Cells, extent and shape of each body."""
    discretisation: Any = found.discretisation
    cells, points = discretisation._cell_nodes(), discretisation._points()
    owner, unit = discretisation.cell_bodies(), _length(found.scene)
    for place, body in enumerate(found.scene.bodies):
        corners = points[cells[owner == place]]
        extent = np.ptp(corners.reshape(-1, points.shape[1]), axis=0)
        size = " x ".join(f"{value:.4g}" for value in extent)
        found.say(OK, f"body {body.tag!r}: {len(corners)} cells, {size}{unit}, E = {body.young}, nu = {body.poisson}")
        worst, where = _worst_cell(corners)
        if worst < BAD_CELL:
            found.say(
                NOTE,
                f"body {body.tag!r} has bad cells, the worst at {np.round(where, 6).tolist()} with a quality of "
                f"{worst:.2g} of 1: stresses are wrong there. Mesh it more evenly",
            )


def _worst_cell(corners: np.ndarray) -> tuple[float, np.ndarray]:
    """Smallest scaled Jacobian of cells, (c, k, dim), and where: volume at a corner over the edges that meet there.

    Stretched bricks have 1, a sliver next to 0.
    """
    count, dim = corners.shape[1:]
    numbers = range(count)
    worst = np.ones(len(corners))
    for at in numbers:
        others = [n for n in numbers if n != at] if count == dim + 1 else [at ^ (1 << axis) for axis in range(dim)]
        edges = corners[:, others] - corners[:, [at]]
        lengths = np.linalg.norm(edges, axis=2).prod(axis=1)
        worst = np.minimum(worst, np.abs(np.linalg.det(edges)) / lengths)
    where = int(worst.argmin())
    return float(worst[where]), corners[where].mean(axis=0)


def _names(found: SceneCheck) -> None:
    """Surfaces of the mesh that the scene does not name."""
    scene, discretisation = found.scene, found.discretisation
    assert discretisation is not None  # looked at by check_scene
    used: set[Any] = {item.tag for item in scene.displacements} | {tag for item in scene.contacts for tag in item.tags}
    used |= {getattr(load, "tag", None) for load in scene.loads}
    idle = sorted(name for name in discretisation.names.facets if isinstance(name, str) and name not in used)
    if idle:
        found.say(NOTE, f"the mesh has surfaces that nothing names: {', '.join(idle)}")


def _pairs(found: SceneCheck) -> None:
    """Each contact pair by itself, so that all of them are told of."""
    discretisation: Any = found.discretisation
    for item in found.scene.contacts:
        surfaces: list[Surface] = []
        rows = None
        with found.heard():
            surfaces = [discretisation.surface(tag) for tag in item.tags]
            rows = item.rows(surfaces, discretisation.size)
        found.pairs.append((surfaces, rows))


def _gaps(found: SceneCheck, problem: ContactProblem, point: np.ndarray) -> None:
    """Distances of the surfaces beside the sag of their facets."""
    gaps, unit = problem.gaps @ problem.amplitudes(point), _length(found.scene)
    for place, (surfaces, _) in enumerate(found.pairs):
        own = gaps[problem.contact_pairs == place]
        if not own.size:
            continue
        sag = max(sag_of(surface) for surface in surfaces)
        names = " and ".join(repr(surface.tag) for surface in surfaces)
        text = (
            f"contact {place} of {names}: {own.size} conditions, gaps from {own.min():.3g} to {own.max():.3g}{unit}, "
            f"facets sag by {sag:.2g}{unit}"
        )
        found.say(OK, text)
        if own.min() < -max(sag, 1e-12) * 2:
            found.say(
                NOTE, f"contact {place} of {names}: bodies overlap by {-own.min():.3g}{unit} before anything moves"
            )
        elif TOUCHING * sag < own.min() < SMALL_GAP * sag:
            found.say(
                NOTE,
                f"contact {place} of {names}: the smallest gap, {own.min():.3g}{unit}, is less than the sag of facets, "
                f"{sag:.2g}{unit}: which nodes touch first is made by the mesh. Refine the curved surfaces",
            )


def sag_of(surface: Surface) -> float:
    """Largest distance of the facets of a surface from the arcs that their neighbours say they stand for.

    An arc that turns by 2 a along a facet of length h is h a / 4 away from it; a is the angle from the normal of the
    facet to that at its corners, which is averaged but for edges of the body.
    """
    if not surface.facets.size:
        return 0.0
    cosines = np.einsum("fd,fkd->fk", surface.outward, surface.corner_normals()).min(axis=1)
    angles = np.arccos(np.clip(cosines, -1.0, 1.0))
    lengths = np.linalg.norm(np.ptp(surface.corners, axis=1), axis=1)
    return float((lengths * angles).max() / 4)


def _supports(found: SceneCheck, problem: ContactProblem) -> None:
    """What holds each body."""
    discretisation, scene = found.discretisation, found.scene
    assert discretisation is not None
    free = free_bodies(scene, problem.points, problem.cell_nodes, discretisation.cell_bodies(), problem.free)
    for body in free:
        found.say(NOTE, f"{body.name} is held by contact alone, and without it {described(body, body.left)}")
    if not free:
        found.say(OK, "displacements hold every body")


def _loads(found: SceneCheck) -> None:
    """Resultant of each load for the amplitude 1; loads that reach nothing."""
    discretisation: Any = found.discretisation
    dim = discretisation.mesh.geometry.dim
    for load in found.scene.loads:
        with found.heard():
            parts = [csc_matrix(np.atleast_2d(term.columns).T if np.ndim(term.columns) == 1 else term.columns)
                     for term in load.terms(discretisation.assembler(load))]  # fmt: skip
            name = f"{type(load).__name__} on {getattr(load, 'tag', 'the scene')!r}"
            if not any(part.count_nonzero() for part in parts):
                found.say(
                    MISTAKE, f"{name} reaches nothing: its nodal forces are zero. Name another tag, or leave it out"
                )
                continue
            if all(part.shape[1] == 1 for part in parts):
                total = sum(part.toarray().reshape(-1, dim).sum(axis=0) for part in parts)
                found.say(OK, f"{name}: resultant {np.round(total, 6).tolist()} for the amplitude 1")
            else:
                found.say(OK, f"{name}: {sum(part.shape[1] for part in parts)} columns that depend on parameters")
