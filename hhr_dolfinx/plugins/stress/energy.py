"""Elastic energy of bodies from the mesh: work of forces, springs, and strains that cause no
stress.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import ufl
from dolfinx import fem
from scipy.sparse import coo_matrix, csc_matrix, csr_matrix, hstack, vstack
from ufl.core.expr import Expr

from hhr_dolfinx import compat
from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.contact.law import UNILATERAL
from hhr_dolfinx.contact.problem import ContactProblem, masked
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.loads import checked_terms
from hhr_dolfinx.models.functionals.functional import Functional
from hhr_dolfinx.plugins.stress.kinds import Energy, StoredEnergy

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Formula
    from hhr_dolfinx.full_order.discretisation import Discretisation
    from hhr_dolfinx.models.histories.equilibrium import StressOutput
    from hhr_dolfinx.outputs import ModelProbe, NamedOutput


class WorkOfForces(NamedTuple):
    """Arrays of the work of forces, named as in :class:`Energy`."""

    rows: csr_matrix  #: (k, N)
    moduli: tuple[str, ...]
    terms: np.ndarray
    parts: np.ndarray
    lifted: np.ndarray
    lifts: np.ndarray
    own: np.ndarray


def energy_of(probe: ModelProbe, output: NamedOutput) -> Functional:
    """Elastic energy of all bodies, an ``ElasticEnergy``: by the stress of laws, else by the work
    of forces.

    Args:
        probe: interface of the model.
        output: the ``ElasticEnergy``.

    Raises:
        SceneError: for laws whose plug-in knows no elasticity of the bodies.
    """
    scene = probe.discretisation.scene
    if probe.laws is not None:
        if not hasattr(probe.laws, "energy"):
            raise SceneError(
                f"output '{output.name}': the plug-in that reads the laws of scene '{scene.name}' "
                "gives no elasticity C of the bodies, of which the energy ∫ σ : C^-1 σ / 2 needs "
                "the inverse: leave it out"
            )
        functional: Functional = probe.laws.energy(output)
        return functional
    problem = probe.problem
    # a unilateral condition with a force has no slack; those of other laws have
    unilateral = problem.law is UNILATERAL
    work = _work(probe, problem)
    gap_terms = probe.terms(problem.gaps.any(axis=0)).astype(np.int64)[: None if unilateral else 0]
    gaps = np.ascontiguousarray(problem.gaps[:, gap_terms])
    strained = any(hasattr(load, "eigenstrain_of") for load in scene.loads)
    springs = probe.discretisation.springs
    names = problem.parameters.names
    arrays = work.terms, work.parts, work.lifted, work.lifts, gap_terms, gaps, work.own
    if unilateral and springs is None and not strained:
        return Energy(output.name, output.unit, *_entries(work.rows), names, work.moduli, *arrays)
    touching = np.arange(0 if unilateral else len(problem.gaps), dtype=np.int64)
    pressed = csr_matrix(problem.contact[touching])
    touching_lifts = (pressed @ problem.lifts.tocsc()[:, work.lifted]).toarray()
    stiff = np.zeros(0) if springs is None else springs
    held = np.flatnonzero(stiff)
    size = problem.free.size
    grounded = csr_matrix(
        (np.ones(held.size), (np.arange(held.size), held)), shape=(held.size, size)
    )
    terms = _strained_terms(probe.discretisation) if strained else np.zeros(0, dtype=np.int64)
    forces = csr_matrix(csc_matrix(problem.forces)[:, terms].T)
    pairs = list(_strain_energies(probe.discretisation, output)) if strained else []
    rows = _entries(csr_matrix(vstack([work.rows, pressed, grounded, forces])))
    factors = tuple(text for text, _ in pairs)
    more = touching, touching_lifts, stiff[held], terms
    energies = np.array([energy for _, energy in pairs], dtype=float)
    return StoredEnergy(
        output.name, output.unit, *rows, names, work.moduli, *arrays, *more, factors, energies
    )


def _entries(matrix: csr_matrix) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Rows of an output as its first fields."""
    entries: coo_matrix = matrix.tocoo()
    return matrix.shape[0], entries.row.astype(np.int64), entries.col.astype(np.int64), entries.data


def _work(probe: ModelProbe, problem: ContactProblem) -> WorkOfForces:
    """The work of all forces but contact."""
    moduli = tuple(f"({modulus.factor}) * ({modulus.rest})" for modulus in problem.moduli) or ("1",)
    # a user's K without parts is refused: it is read here
    count = len(problem.stiffness_terms if problem.moduli else (problem.own_stiffness,))
    external = problem.external
    loaded = probe.terms(np.diff(external.indptr))
    lifted = np.flatnonzero(np.diff(problem.lifts.tocsc().indptr))
    lifts = problem.lifts.tocsc()[:, lifted]
    pulls = problem.pulls if problem.moduli else (problem.pulled,)
    pulled = [csc_matrix(pull[:, lifted]) for pull in pulls]
    acting = (problem.prolongation.restrict(pull) for pull in pulled)
    blocks = [external[:, loaded], *(masked(pull, problem.free) for pull in acting)]
    rows = csr_matrix(hstack([csc_matrix(block) for block in blocks]).T)
    terms = np.concatenate([loaded, np.tile(lifted, count)]).astype(np.int64)
    part_of_terms = np.concatenate(
        [np.full(loaded.size, -1), np.repeat(np.arange(count), lifted.size)]
    )
    squares = np.array([(lifts.T @ pull).toarray() for pull in pulled])
    squares = squares.reshape(count, lifted.size, lifted.size)
    work_of_lifts = (rows @ lifts).toarray()
    return WorkOfForces(
        rows,
        moduli,
        terms,
        part_of_terms.astype(np.int64),
        lifted.astype(np.int64),
        squares,
        work_of_lifts,
    )


def _strained_terms(discretisation: Discretisation) -> np.ndarray:
    """Terms of θ of the loads that stand for strains without stress."""
    marks = []
    for load in discretisation.scene.loads:
        for term in checked_terms(load, discretisation.assembler(load)):
            mark = float(hasattr(load, "eigenstrain_of"))
            marks.append(csc_matrix(np.full((1, term.columns.shape[1]), mark)))
    return np.flatnonzero(discretisation.terms.columns("loads", 1, marks).toarray()[0]).astype(
        np.int64
    )


def _strain_energies(
    discretisation: Discretisation, output: NamedOutput
) -> Iterator[tuple[str, float]]:
    """Energies ∫ ε0 : C ε0 / 2 of strains without stress: factors as formulas, and values for these
    factors 1.
    """
    mesh = discretisation.mesh
    loads = [load for load in discretisation.scene.loads if hasattr(load, "eigenstrain_of")]
    for index, body in enumerate(discretisation.scene.bodies):
        eigenstrains = [load.eigenstrain_of(body.tag, mesh) for load in loads]
        strains = [
            (text_of(amplitude, output), strain) for amplitude, strain in filter(None, eigenstrains)
        ]
        for (first, first_strain), (second, second_strain) in product(strains, repeat=2):
            for modulus, energy in _energies(discretisation, index, first_strain, second_strain):
                yield f"({first}) * ({second}) * ({modulus})", energy


def text_of(amplitude: Amplitude | Formula, output: NamedOutput | StressOutput) -> str:
    """An amplitude of a strain as a formula.

    Args:
        amplitude: the amplitude.
        output: the output that needs it, for the message.

    Raises:
        SceneError: if names of parameters cannot stand in a formula.
    """
    if not isinstance(amplitude, Amplitude):
        return amplitude.text
    wrong = [name for name in amplitude.slopes if not name.isidentifier()]
    if wrong:
        raise SceneError(
            f"output '{output.name}': it needs the amplitude of a strain in a formula, where "
            f"names of parameters are words: {wrong[0]!r} is no word"
        )
    slopes = (f"({float(slope)!r}) * {name}" for name, slope in amplitude.slopes.items())
    return " + ".join([repr(float(amplitude.constant)), *slopes])


def _energies(
    discretisation: Discretisation, place: int, own: Expr, other: Expr
) -> Iterator[tuple[str, float]]:
    """∫ own : C other / 2 of two strains of a body, 3x3: for each part of C its modulus, and the
    rest.

    The stress is that of :func:`hhr_dolfinx.plugins.elasticity.eigenstrains.eigenstress`.
    """
    from hhr_dolfinx.plugins.elasticity.eigenstrains import averaged
    from hhr_dolfinx.plugins.elasticity.gauss_points import degree_of
    from hhr_dolfinx.plugins.elasticity.parts import grading_of, parts_of

    scene = discretisation.scene
    body = scene.bodies[place]
    hypothesis = scene.hypothesis
    dx = discretisation.cells(body.tag)
    weight = elasticity.volume_weight(discretisation.mesh, hypothesis)

    def energy(stress: Expr, strain: Expr) -> float:
        """Half the integral of stress times strain over the body."""
        form = compat.jitted(fem.form, weight * ufl.inner(stress, strain) / 2 * dx)
        return float(sum(discretisation.group.gathered(float(fem.assemble_scalar(form)))))

    if (stress_of := scene.own_stress(body, discretisation.mesh)) is not None:
        yield "1", energy(stress_of(own), other)
        return
    if discretisation.mean_dilatation[place]:
        dx = dx(degree=degree_of(discretisation))
    graded = averaged(
        discretisation,
        place,
        grading_of(discretisation, body) * averaged(discretisation, place, own),
    )
    measured = elasticity.in_plane(averaged(discretisation, place, other), hypothesis)
    stresses = elasticity.isotropic_parts(graded, hypothesis)
    for stiffness_part in parts_of(body, hypothesis):
        moduli = map(discretisation.constant, stiffness_part.moduli)
        chosen = zip(moduli, stresses, strict=True)
        stress = sum(
            modulus * stress_part for modulus, stress_part in chosen if float(modulus.value)
        )
        yield f"({stiffness_part.factor}) * ({stiffness_part.rest})", energy(stress, measured)
