"""Paths to train on."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.errors import NotOfferedError, ParameterError, StudyError
from hhr_dolfinx.models.histories.path import checked_path
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.study.training.train import chooses_itself

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Path


def training_queries(
    scene: Scene, training: Any, held_out: Sequence[Path] | np.ndarray | None
) -> tuple[Any, list[Path]]:
    """Training and validation paths, checked: the tool ``queries``.

    Args:
        scene: the scene.
        training: paths to train on, or a training that chooses them.
        held_out: paths that are held out; empty or None without any.

    Returns:
        The paths, or the training, and the paths that are held out.

    Raises:
        StudyError: for an invalid list of paths.
        NotOfferedError: for a training that chooses histories of contacts that remember.
    """
    chooses = chooses_itself(training)
    if chooses and scene.remembers:
        raise NotOfferedError(
            f"contacts of scene '{scene.name}' remember their path, and a training that chooses "
            "such histories itself is not built in: train on a list of paths, or condense it "
            "without a training, hhr.condense(scene)"
        )
    if chooses:
        training.space(scene)
    apart = held_out.tolist() if isinstance(held_out, np.ndarray) else held_out
    queries = training if chooses else training_paths(scene, training)
    return queries, training_paths(scene, apart) if apart else []


def training_paths(scene: Scene, paths: Iterable[Path]) -> list[Path]:
    """Checked paths of a scene whose answers depend on their path.

    Args:
        scene: the scene.
        paths: load paths, each with a start and a step at least.

    Raises:
        StudyError: for an invalid list of paths.
    """
    advice = (
        f"answers of scene '{scene.name}' depend on the path that leads to them: train on a list "
        "of paths, such as family.paths(Sobol(12)), or by hhr reduce with PATHS, a "
        "hhr.PathFamily, beside the scene"
    )
    if not isinstance(paths, Iterable):
        raise StudyError(f"{advice}; {paths!r} is no such list")
    try:
        pairs = [(path, checked_path(scene.parameters, path)) for path in paths]
    except (ParameterError, TypeError) as error:
        raise StudyError(f"{advice} ({error})") from None
    # paths of a family keep their names
    checked = [
        path if isinstance(getattr(path, "name", None), str) else plain_path
        for path, plain_path in pairs
    ]
    if not checked or min(len(path) for path in checked) < 2:
        raise StudyError(
            f"training of scene '{scene.name}' needs at least one path, each with a start and a "
            "step"
        )
    return checked
