"""Named errors and warnings. Each message gives the value, the limit and what to try."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


class HHRError(Exception):
    """Base of every error this package raises on purpose."""


class SceneError(HHRError, ValueError):
    """The scene cannot be built: a missing tag, surfaces that do not face each other, an unknown
    name.
    """


class NeverFacingError(SceneError):
    """The surfaces of a contact pair do not face each other at their positions."""


class StudyError(HHRError, ValueError):
    """A training or study cannot be run: an invalid count, seed or folder."""


class ParameterError(HHRError, ValueError):
    """A parameter is not finite, has the wrong length, or lies outside the box of the scene."""


class ShapeError(ParameterError):
    """The shape of a scene changes more over its box than its mesh and its contact pairs allow."""


class OutsideTrainingError(ParameterError):
    """A query lies outside the training range of a reduced model, and ``outside`` is ``refuse``."""


class NotOfferedError(HHRError, TypeError):
    """A kind of model does not offer a request; the message gives the reason and a model that
    does.
    """


class ReductionError(HHRError, ValueError):
    """The reduced model cannot be built from these snapshots or settings."""


class ClaimError(ReductionError):
    """A model calls itself exact, and answers of the full model deny it."""


class UnseenLoadError(ReductionError):
    """A load does not act on the reduced integration domain; more layers of cells may help."""


class NotSolvableError(HHRError):
    """No unique solution: dependent contact rows, thesis (1.67), a singular stiffness, numbers that
    are not finite.
    """


class SingularError(NotSolvableError):
    """A matrix is singular; the caller may know the reason."""


class UnstableModelError(HHRError):
    """A stability constant shows that the model is not reliable."""


class BoundError(NotOfferedError):
    """A hypothesis of an error bound fails, so that no bound is offered."""


class ConvergenceError(HHRError):
    """The statuses did not converge; no solution is returned."""


class ConformanceError(HHRError, AssertionError):
    """A user-defined part breaks the contract of its seam, which a check of ``hhr_dolfinx.testing``
    tells.
    """


class RankError(HHRError):
    """Another rank failed with an error that is not one of this package, or ranks were given
    different things.
    """


class MissingPackageError(HHRError, ImportError):
    """An optional package that this scene, model or picture needs is not installed."""


class FileError(HHRError, OSError):
    """A file or folder cannot be written: no space, no permission, or a file instead of a
    folder.
    """


class FileContentError(HHRError, ValueError):
    """A file cannot be read, is damaged, or has other content."""


class ModelFileError(FileContentError):
    """A model file is damaged, of another version, or no model file at all."""


class StabilityWarning(UserWarning):
    """A stability constant is outside the range of reliable models."""


class TrainingWarning(StabilityWarning):
    """The training lacks information that the model needs: no check of the model can make up for
    it.
    """


class PairingWarning(UserWarning):
    """Some nodes of a contact pair have no partner, or bodies overlap by more than a cell."""


class BudgetWarning(UserWarning):
    """An adaptive training spent its budget before it reached its target accuracy."""


class NoBoundWarning(UserWarning):
    """A model has no error estimate, so that wrong answers are silent."""


class OutsideTrainingWarning(UserWarning):
    """A reduced model answers outside its training range: its errors are unknown."""


class UncheckedWarning(UserWarning):
    """A reduced model was not compared with held-out solutions."""


class LocalModelWarning(UserWarning):
    """Some local models are larger, or less accurate, than the target."""


class UndeterminedWarning(UserWarning):
    """Contact does not determine a rigid-body motion: the answer is the one of least motion."""


class PluginWarning(UserWarning):
    """A plug-in is installed and is left out: it cannot be loaded, or needs another one."""


class SceneWarning(UserWarning):
    """Something in a scene has no effect, or its imposed displacements contradict its contacts."""


class MeshWarning(UserWarning):
    """Nodes of a mesh file are displaced so that its cells are valid."""


class SnapshotFileWarning(UserWarning):
    """A stored solution is damaged or belongs to another problem.

    It is solved again and its file replaced.
    """


class ModelFileWarning(UserWarning):
    """A file omits a part of a model, which is code, or the model runs slowly here."""


class LockingWarning(UserWarning):
    """A nearly incompressible body is meshed with cells that are too stiff for it: linear triangles
    or tetrahedra.
    """


class SmallStrainWarning(UserWarning):
    """Strains or rotations are too large for the small-strain theory."""


class FarSlidingWarning(UserWarning):
    """Surfaces have slid farther than the cells on which they were paired."""


class TimeStepWarning(UserWarning):
    """The time steps of a history are too long for the rates of its laws."""


def rounded(place: Iterable[float]) -> list[float]:
    """Coordinates for a message, to six digits.

    Those that are round-off of the largest one are zero.
    """
    values = [float(value) for value in place]
    least = 1e-12 * max(map(abs, values), default=0.0)
    return [0.0 if abs(value) <= least else float(f"{value:.6g}") for value in values]


def class_of(name: str) -> type[HHRError]:
    """Error class of this package with a name, or :class:`RankError`."""
    kind = globals().get(name)
    return kind if isinstance(kind, type) and issubclass(kind, HHRError) else RankError
