"""Reduction of inelastic bodies and its check: the facets ``reduction`` and ``comparison``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhr_dolfinx.certify.accuracy import Residuals, Solutions, contact_residuals, slack_residuals
from hhr_dolfinx.certify.compare import Comparison
from hhr_dolfinx.certify.trust import OF_A_RID, TRAINED, TrustLimits, compared_histories
from hhr_dolfinx.errors import HHRError, ReductionError, StabilityWarning, TrainingWarning
from hhr_dolfinx.models.answer import Answer, History, Model, Path
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.plugins.inelastic.completion import FlowFields, GappyField
from hhr_dolfinx.plugins.inelastic.full_order import equilibrium_of
from hhr_dolfinx.plugins.inelastic.recipe import flowing
from hhr_dolfinx.plugins.inelastic.softening import warn_of_softening
from hhr_dolfinx.plugins.inelastic.state import GaussState, flowed, rows_of, state, state_modes, states_of
from hhr_dolfinx.plugins.inelastic.trained import Known, Signs, TrainedPaths
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.snapshots.records import SnapshotSet
from hhr_dolfinx.warn import warn

STRESS = 1e-9
PLASTIC_STRAIN = 1e-6
"""Part of the squared training fields that the modes for stress and for cumulated plastic strain leave out."""


PARTS = 8
"""Parts of first steps, in which bodies come into contact and yield: states on a finer path along a trained one have
estimates up to nine times those of the training steps."""


def _state_errors(found: History, exact: History) -> tuple[float, float]:
    """Largest errors of stress and cumulated plastic strain everywhere over their largest norm in the load path."""
    wrong = np.zeros((2, len(exact.answers)))
    sizes = np.zeros((2, len(exact.answers)))
    for k, (here, there) in enumerate(zip(found.answers, exact.answers, strict=True)):
        stress = there.stress()
        plastic = there.plastic_strain()
        wrong[:, k] = np.linalg.norm(here.stress() - stress), np.linalg.norm(here.plastic_strain() - plastic)
        sizes[:, k] = np.linalg.norm(stress), np.linalg.norm(plastic)
    largest = sizes.max(axis=1)
    stress, plastic = wrong.max(axis=1) / np.where(largest > 0, largest, 1.0)
    return float(stress), float(plastic)


def checked_histories(
    full: FullModel,
    model: Model,
    snapshots: Solutions,
    held_out: Solutions | None,
    limits: TrustLimits | None,
    remedy: str | Mapping[str, str] = OF_A_RID,
) -> tuple[Comparison | None, TrainedPaths | None]:
    """Errors against known load paths, and the training range; None without limits, or without any path.

    Raises:
        UnstableModelError: for errors beyond the limits.

    Warns:
        StabilityWarning: for errors or a training range close to a limit, and for laws that soften in training.
    """
    warn_of_softening(full, snapshots)
    comparison, shown = compared_histories(full, model, snapshots, held_out, limits, remedy)
    # validation paths are not training: their errors would widen the training range to similar ones
    signs = [signs for label, signs in shown.items() if label.startswith(TRAINED)]
    if not signs:  # without limits all paths may have failed
        return None, None
    paths = [history.path for history in snapshots.histories]
    problem = full.problem
    gaps = problem.amplitudes.sum_columns(problem.gaps, snapshots.points)
    motion = problem.contact_rows_times(snapshots.displacements)
    largest = max(float(np.abs(gaps).max()), float(np.abs(motion).max()))
    known = Known(signs, [_onset(model, path) for path in paths], largest)
    trained = TrainedPaths.of(paths, full.parameters, known, equilibrium_of(full).material.rated)
    if limits is not None:
        check_door(trained, limits)
    return comparison, trained


def check_door(trained: TrainedPaths, limits: TrustLimits) -> None:
    """Warn of a model so inaccurate along known load paths that its steps hardly detect untrained states."""
    if trained.estimate > limits.warn_estimate:
        warn(
            f"the stress of known histories differs by up to {trained.estimate:.2g} of its size from combinations of "
            f"trained ones: other histories are warned of from {trained.allowed(trained.begun):.2g} on only. Keep more "
            "modes, allow more points, or train on more histories",
            StabilityWarning,
        )


def _onset(model: Model, path: Path) -> list[Signs]:
    """Signs along the first step of a path in small parts; empty if it does not converge."""
    (start, here), (end, there) = path[:2]
    shares = np.arange(PARTS + 1) / PARTS
    parts = [(start + share * (end - start), here + share * (there - here)) for share in shares]
    try:
        return model.march(parts, MarchSettings(outside="ignore")).signs
    except HHRError:
        return []


@dataclass(frozen=True)
class FittedFlow:
    """POD modes of the fields of Gauss points in training; None if they are zero."""

    stress: np.ndarray | None = None  # of the stress, (Gauss points * components, modes)
    plastic_strain: np.ndarray | None = None  # of the cumulated plastic strain, (Gauss points, modes)

    @classmethod
    def of(cls, snapshots: SnapshotSet) -> FittedFlow:
        """Modes of training answers."""
        known = states_of(snapshots)
        if not known:
            return cls()
        stress = state_modes([item.stress.ravel() for item in known], STRESS)
        if not flowed(snapshots):
            return cls(stress)
        return cls(stress, state_modes([item.state.cumulated for item in known], PLASTIC_STRAIN))

    def completion(self, flow: Any) -> FlowFields:
        """Reconstruction of stress and cumulated plastic strain from the Gauss points of the RID (section 6.2.3)."""
        if self.stress is None:
            raise ReductionError("these snapshots hold no stress: give histories of a scene whose bodies flow")
        components = flow.material.components
        points = flow.points
        stress = GappyField.fitted(self.stress, rows_of(points, components))
        flowed = None if self.plastic_strain is None else GappyField.fitted(self.plastic_strain, points)
        return FlowFields(points, stress, flowed, len(self.stress) // components)


class _Comparison:
    """Facet ``comparison``, see :class:`hhr_dolfinx.certify.compare.ComparedLaws`."""

    errors = staticmethod(_state_errors)

    def residuals(self, full: FullModel, answer: Answer) -> Residuals:
        """Residuals of the whole stress of an answer; of displacements alone by K, as those of rivals may be."""
        problem = full.problem
        equilibrium = equilibrium_of(full)
        theta = problem.amplitudes(answer.parameter)
        forces = answer.forces()
        opened = problem.law.opened(answer.memory)
        if "gauss" not in answer.memory:
            return contact_residuals(problem.at(answer.parameter), answer.displacement(), forces, theta, opened)
        given = GaussState(answer.stress(), state(answer).state)
        left, sizes = equilibrium.residual(answer.unknown, given, theta)
        residual = (left - equilibrium.contact_load(forces)) * problem.free
        imbalance = float(np.linalg.norm(residual) / (np.linalg.norm(sizes) or 1.0))
        homogeneous = answer.displacement() - problem.lifts @ theta
        return Residuals(imbalance, *slack_residuals(problem, homogeneous, forces, theta, opened))

    def warn_of_training(self, full: FullModel, snapshots: Solutions) -> None:
        """Warn of histories without plastic strain."""
        material = equilibrium_of(full).material
        if material.flows and not material.linear and not flowed(snapshots):
            warn(
                "no body flows in any training history though some could: tangents under flow were not checked, and a "
                "history that flows is outside what was trained. Train at higher loads, or leave the laws out",
                TrainingWarning,
            )


class _Reduction:
    """See :class:`hhr_dolfinx.reduction.interface.ReducedBodies`."""

    fitted = staticmethod(FittedFlow.of)
    checked = staticmethod(checked_histories)

    def recipes(self) -> tuple[Recipe, ...]:
        """The usual recipe."""
        return (flowing(),)

    def check_given(self, full: FullModel, name: str, solutions: SnapshotSet) -> None:
        """Raise ReductionError for solutions that are no histories, or those of elastic bodies or another mesh."""
        if not solutions.histories:
            raise ReductionError(f"{name} of a scene whose bodies flow must be histories: SnapshotSet.of_histories")
        if not solutions.states:
            raise ReductionError(f"bodies of the model flow, and none of {name} do: they belong to another scene")
        size = equilibrium_of(full).material.gauss_points
        if (given := len(states_of(solutions)[0].state.cumulated)) != size:
            raise ReductionError(f"{name} have {given} Gauss points, the model {size}: they belong to another mesh")


REDUCTION = _Reduction()
COMPARISON = _Comparison()
