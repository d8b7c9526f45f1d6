"""Reduction of inelastic bodies and its check: the facet ``reduction``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.certify.accuracy import Residuals, slack_residuals
from hhr_dolfinx.certify.compare import Comparison
from hhr_dolfinx.certify.trust import TrustLimits, warn_of_few_held_out, warn_of_no_contact
from hhr_dolfinx.errors import (
    HHRError,
    NotOfferedError,
    ReductionError,
    StabilityWarning,
    TrainingWarning,
)
from hhr_dolfinx.models.answer import Answer, History, Model, Path
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.plugins.inelastic.completion import FlowFields, GappyField
from hhr_dolfinx.plugins.inelastic.full_order import equilibrium_of
from hhr_dolfinx.plugins.inelastic.recipe import (
    PLASTIC_ERROR,
    STRESS_ERROR,
    FlowLimits,
    flowing,
    tangents_of,
)
from hhr_dolfinx.plugins.inelastic.softening import warn_of_softening
from hhr_dolfinx.plugins.inelastic.state import (
    GaussState,
    flowed,
    rows_of,
    state,
    state_modes,
    states_of,
)
from hhr_dolfinx.plugins.inelastic.trained import Known, Signs, TrainedPaths
from hhr_dolfinx.plugins.paths.compared import TRAINED, compared_histories
from hhr_dolfinx.plugins.paths.kinds import OfHistories
from hhr_dolfinx.reduction.kinds import OfPoints
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.snapshots.records import SnapshotSet, check_of_problem
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.inelastic.reduced_flow import ReducedFlow

STRESS_LEFT_OUT = 1e-9
"""Part of the squared training stresses that their modes leave out."""
PLASTIC_STRAIN = 1e-6
"""Part of the squared cumulated plastic strains of a training that their modes leave out."""


FIRST_STEP_PARTS = 8
"""Parts of first steps, in which bodies come into contact and yield: states on a finer path along a
trained one have estimates up to nine times those of the training steps.
"""


class StateErrors:
    """Largest errors of stress and cumulated plastic strain everywhere over their largest norm in
    the load path.
    """

    names = STRESS_ERROR, PLASTIC_ERROR

    def __call__(self, found: History, exact: History) -> tuple[float, float]:
        """Both errors of a history."""
        wrong = np.zeros((2, len(exact.answers)))
        sizes = np.zeros((2, len(exact.answers)))
        for k, (answer, reference) in enumerate(zip(found.answers, exact.answers, strict=True)):
            stress = reference.stress()
            plastic = reference.plastic_strain()
            wrong[:, k] = (
                np.linalg.norm(answer.stress() - stress),
                np.linalg.norm(answer.plastic_strain() - plastic),
            )
            sizes[:, k] = np.linalg.norm(stress), np.linalg.norm(plastic)
        largest = sizes.max(axis=1)
        stress, plastic = wrong.max(axis=1) / np.where(largest > 0, largest, 1.0)
        return float(stress), float(plastic)


def check_door(trained: TrainedPaths, limits: FlowLimits) -> None:
    """Warn of a model so inaccurate along known load paths that its steps hardly detect untrained
    states.

    Args:
        trained: training range of the model.
        limits: limits of stress and strain.
    """
    if trained.estimate > limits.warn_estimate:
        warn(
            f"the stress of known histories differs by up to {trained.estimate:.2g} of its size "
            "from combinations of trained ones: other histories are warned of from "
            f"{trained.allowed(trained.begun):.2g} on only. Keep more modes, allow more points, "
            "or train on more histories",
            StabilityWarning,
        )


def _onset(model: Model, path: Path) -> list[Signs]:
    """Signs along the first step of a path in small parts; empty if it does not converge."""
    (start, first), (end, second) = path[:2]
    shares = np.arange(FIRST_STEP_PARTS + 1) / FIRST_STEP_PARTS
    fine = [(start + share * (end - start), first + share * (second - first)) for share in shares]
    try:
        return model.march(fine, MarchSettings(outside="ignore")).signs
    except HHRError:
        return []


@dataclass(frozen=True)
class FittedFlow:
    """POD modes of the fields of Gauss points in training; None if they are zero."""

    stress: np.ndarray | None = None  #: of the stress, (Gauss points * components, modes)
    plastic_strain: np.ndarray | None = (
        None  # of the cumulated plastic strain, (Gauss points, modes)
    )

    @classmethod
    def of(cls, snapshots: SnapshotSet) -> FittedFlow:
        """Modes of training answers."""
        states = states_of(snapshots)
        if not states:
            return cls()
        stress = state_modes([gauss.stress.ravel() for gauss in states], STRESS_LEFT_OUT)
        if not flowed(snapshots):
            return cls(stress)
        return cls(stress, state_modes([gauss.state.cumulated for gauss in states], PLASTIC_STRAIN))

    def completion(self, flow: ReducedFlow) -> FlowFields:
        """Reconstruction of stress and cumulated plastic strain from the Gauss points of the RID
        (section 6.2.3).

        Raises:
            ReductionError: if the training has no stress.
        """
        if self.stress is None:
            raise ReductionError(
                "these snapshots hold no stress: give histories of a scene whose bodies flow"
            )
        components = flow.material.components
        points = flow.points
        stress = GappyField.fitted(self.stress, rows_of(points, components))
        flowed = (
            None if self.plastic_strain is None else GappyField.fitted(self.plastic_strain, points)
        )
        return FlowFields(points, stress, flowed, len(self.stress) // components)


class OfInelasticBodies(OfHistories):
    """Answers of inelastic bodies, and of elastic ones beside them.

    Their contacts are unilateral or have laws.
    """

    def __init__(self, full: FullModel):
        super().__init__(full)
        contacts = registry.tool("reduction", "a reduced model") if full.law.plugin else OfPoints
        self.contacts: OfPoints = contacts(full)
        self.cone = self.contacts.cone

    def recipes(self) -> tuple[Recipe, ...]:
        """The usual recipe."""
        return (flowing(),)

    def not_by_rows(self) -> str:
        """As their contacts say."""
        return self.contacts.not_by_rows()

    @property
    def unbounded(self) -> str:
        """As their contacts say."""
        return self.contacts.unbounded

    def require_linear(self, what: str) -> None:
        """Raise ReductionError."""
        raise ReductionError(f"bodies of scene '{self.full.scene.name}' have laws: {what}")

    def condensed_from(
        self, snapshots: SnapshotSet, held_out: SnapshotSet | None
    ) -> tuple[SnapshotSet | None, SnapshotSet | None, bool | None]:
        """Histories for a condensed model, with fields as settings say.

        Args:
            snapshots: training answers.
            held_out: validation answers, if any.
        """
        return snapshots, held_out, None

    def skipped(self, recipe: Recipe) -> Iterator[tuple[str, str]]:
        """Tangents, and the indicator."""
        if tangents_of(recipe) is None:
            yield "tangents", "not requested"
        yield from super().skipped(recipe)

    def check(self, name: str, solutions: SnapshotSet | None) -> SnapshotSet:
        """Check solutions of inelastic bodies.

        Args:
            name: name of the answers, for messages.
            solutions: answers as a user gives them.

        Raises:
            NotOfferedError: for shapes that are parameters.
            ReductionError: for solutions that are no histories, or those of elastic bodies or
                another mesh.
        """
        problem = self.full.problem
        self.contacts.require_completion()
        if problem.reshaped is not None:
            raise NotOfferedError(
                "hyper-reduction is not built in for bodies with laws whose shape depends on "
                "parameters: weights of points and strains of modes change with the shape"
            )
        histories = check_of_problem(name, solutions, problem)
        if not histories.histories:
            raise ReductionError(
                f"{name} of a scene whose bodies flow must be histories: SnapshotSet.of_histories"
            )
        if not histories.states:
            raise ReductionError(
                f"bodies of the model flow, and none of {name} do: they belong to another scene"
            )
        size = equilibrium_of(self.full).material.gauss_points
        if (count := len(states_of(histories)[0].state.cumulated)) != size:
            raise ReductionError(
                f"{name} have {count} Gauss points, the model {size}: they belong to another mesh"
            )
        return histories

    def warn_of_training(self, snapshots: SnapshotSet, held_out: SnapshotSet | None) -> None:
        """Warn of histories without contact or plastic strain, and without validation.

        Args:
            snapshots: training answers.
            held_out: validation answers, if any.
        """
        warn_of_no_contact(self.full.problem, snapshots)
        material = equilibrium_of(self.full).material
        if material.flows and not material.linear and not flowed(snapshots):
            warn(
                "no body flows in any training history though some could: tangents under flow "
                "were not checked, and a history that flows is outside what was trained. Train at "
                "higher loads, or leave the laws out",
                TrainingWarning,
            )
        warn_of_few_held_out(held_out, 0, "a history")

    def starts(self, snapshots: SnapshotSet, conditions: np.ndarray) -> None:
        """Starts of steps: none, as a step starts from the one before.

        Args:
            snapshots: training answers.
            conditions: conditions of the model.
        """

    def range_of(self, snapshots: SnapshotSet) -> None:
        """None before the check, which solves the known paths."""

    def compared(
        self,
        model: Model,
        snapshots: SnapshotSet,
        held_out: SnapshotSet | None,
        limits: TrustLimits | None,
        remedy: str | Mapping[str, str],
    ) -> tuple[Comparison | None, TrainedPaths | None]:
        """Errors against known load paths, and the training range.

        None without limits, or without any path.

        Args:
            model: model to check.
            snapshots: training answers.
            held_out: validation answers, if any.
            limits: limits of stress and strain; None leaves out the comparison.
            remedy: advice for errors beyond the limits.

        Raises:
            UnstableModelError: for errors beyond the limits.

        Warns:
            StabilityWarning: for errors or a training range close to a limit, and for laws that
            soften in training.
        """
        full = self.full
        warn_of_softening(full, snapshots)
        flow_limits = None if limits is None else FlowLimits.of(limits)
        comparison, shown = compared_histories(
            full, model, snapshots, held_out, flow_limits, remedy, StateErrors()
        )
        # validation paths are not training: their errors would widen the training range to similar
        # ones
        signs = [signs for label, signs in shown.items() if label.startswith(TRAINED)]
        if not signs:  # without limits all paths may have failed
            return None, None
        paths = [history.path for history in snapshots.histories]
        problem = full.problem
        gaps = problem.amplitudes.sum_columns(problem.gaps, snapshots.points)
        motion = problem.contact_rows_times(snapshots.displacements)
        largest = max(float(np.abs(gaps).max()), float(np.abs(motion).max()))
        indicators = Known(signs, [_onset(model, path) for path in paths], largest)
        trained = TrainedPaths.of(
            paths, full.parameters, indicators, equilibrium_of(full).material.rated
        )
        if flow_limits is not None:
            check_door(trained, flow_limits)
        return comparison, trained

    def residuals(self, answer: Answer) -> Residuals:
        """Residuals of the whole stress of an answer.

        Of displacements alone by K, as those of rivals may be.
        """
        if "gauss" not in answer.memory:
            return super().residuals(answer)
        problem = self.full.problem
        equilibrium = equilibrium_of(self.full)
        theta = problem.amplitudes(answer.parameter)
        forces = answer.forces()
        gauss = GaussState(answer.stress(), state(answer).state)
        unbalanced, sizes = equilibrium.residual(answer.unknown, gauss, theta)
        residual = (unbalanced - equilibrium.contact_load(forces)) * problem.free
        imbalance = float(np.linalg.norm(residual) / (np.linalg.norm(sizes) or 1.0))
        homogeneous = answer.displacement() - problem.lifts @ theta
        opened = problem.law.opened(answer.memory)
        return Residuals(imbalance, *slack_residuals(problem, homogeneous, forces, theta, opened))
