"""A rival in one file: the training answer nearest to the question, which any model should beat."""

import numpy as np


class NearestAnswer:
    """Answers with a training solution, moved to the lift of the parameter asked for."""

    def __init__(self, training):
        self._full, snapshots = training.full_order, training.snapshots
        self._points = snapshots.points
        self._answers = [self._full.solve(point, start=active) for point, active in zip(
            snapshots.points, snapshots.active.T, strict=True)]  # fmt: skip

    def solve(self, mu, **_):
        """The nearest answer."""
        point = self._full.parameters.point(mu)
        return self._answers[np.linalg.norm(self._points - point, axis=1).argmin()]._replace(
            parameter=point
        )


class NearestHistory:
    """The same of bodies that flow: the training history whose parameters are nearest on
    average.
    """

    def __init__(self, training):
        self._histories = training.snapshots.histories

    def march(self, path, settings=None):
        """The nearest history with as many steps."""
        points = np.array([point for _, point in path])
        distances = [np.linalg.norm(np.array([point for _, point in history.path]) - points)
                     for history in self._histories]  # fmt: skip
        return self._histories[int(np.argmin(distances))]
