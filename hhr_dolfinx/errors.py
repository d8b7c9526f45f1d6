"""Named errors and warnings. Each message gives the value, the limit and what to try."""


class HHRError(Exception):
    """Base of every error this package raises on purpose."""


class SceneError(HHRError, ValueError):
    """The scene cannot be built: a missing tag, surfaces that do not face each other, an unknown name."""


class NeverFacingError(SceneError):
    """Surfaces that are a contact pair do not face each other where they lie."""


class StudyError(HHRError, ValueError):
    """A training or study cannot be run: an invalid count, seed or folder."""


class ParameterError(HHRError, ValueError):
    """A parameter is not finite, has the wrong length, or lies outside the box of the scene."""


class ShapeError(ParameterError):
    """The shape of a scene changes more over its box than its mesh and its contact pairs allow."""


class OutsideTrainingError(ParameterError):
    """A query lies outside what a reduced model was trained on, and ``outside`` is ``refuse``."""


class NotOfferedError(HHRError, TypeError):
    """A kind of model does not offer what it is asked for; the message says why, and which one does."""


class ReductionError(HHRError, ValueError):
    """The reduced model cannot be built from these snapshots or settings."""


class UnseenLoadError(ReductionError):
    """A load does not act on the reduced integration domain, which more layers of cells may cure."""


class NotSolvableError(HHRError):
    """No unique solution: dependent contact rows, thesis (1.67), a singular stiffness, numbers that are not finite."""


class SingularError(NotSolvableError):
    """A matrix is singular, where the caller may know why."""


class UnstableModelError(HHRError):
    """A stability constant says that the model must not be trusted."""


class BoundError(NotOfferedError):
    """A hypothesis of a bound fails, so that none is offered: nothing is proved here."""


class ConvergenceError(HHRError):
    """The statuses did not settle; no solution is handed out."""


class RankError(HHRError):
    """Another rank failed with an error that is none of this package's."""


class MissingPackageError(HHRError, ImportError):
    """An optional package is not installed that this scene, model or picture needs."""


class FileError(HHRError, OSError):
    """A file or folder cannot be written: no space, no permission, a file in the place of a folder."""


class FileContentError(HHRError, ValueError):
    """A file cannot be read, is damaged, or holds something else."""


class ModelFileError(FileContentError):
    """A model file is damaged, of another version, or no model file at all."""


class StabilityWarning(UserWarning):
    """A stability constant is outside the range seen in trustworthy models."""


class TrainingWarning(StabilityWarning):
    """The training as a whole does not show what a model is asked for: no check of the model can make it good."""


class PairingWarning(UserWarning):
    """Some nodes of a contact pair have no partner, or bodies overlap by more than a cell."""


class BudgetWarning(UserWarning):
    """What chooses its own training spent its budget before its wish was met."""


class NoBoundWarning(UserWarning):
    """Nothing is known of the errors of a model's answers, so that wrong ones are silent."""


class OutsideTrainingWarning(UserWarning):
    """A reduced model answers what it was not trained on: its errors are unknown."""


class UncheckedWarning(UserWarning):
    """A reduced model was not compared with solutions kept out of its training."""


class LocalModelWarning(UserWarning):
    """Some of several local models are larger, or less exact, than was wished."""


class UndeterminedWarning(UserWarning):
    """Contact does not determine a rigid motion of a body: of all answers that of least motion is given."""


class PluginWarning(UserWarning):
    """A plug-in is installed and is left out: it cannot be loaded, or needs another one."""


class SceneWarning(UserWarning):
    """Something in a scene has no effect, or its imposed displacements contradict its contacts."""


class SnapshotFileWarning(UserWarning):
    """A stored solution is damaged or belongs elsewhere; it is solved anew and its file replaced."""


class ModelFileWarning(UserWarning):
    """A part of a model is code, and stays out of its file."""


class LockingWarning(UserWarning):
    """A body that keeps its volume is meshed with cells that are too stiff for it: linear triangles or tetrahedra."""


class SmallStrainWarning(UserWarning):
    """Strains or rotations are so large that a theory of small strains says little of them."""


class FarSlidingWarning(UserWarning):
    """Surfaces have slid farther than the cells that they were paired on."""


class LawWarning(UserWarning):
    """A law answers with a slope that is not the derivative of its flow."""


class TimeStepWarning(UserWarning):
    """The time steps of a history are too long for the rates of its laws."""
