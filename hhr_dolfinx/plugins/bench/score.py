"""Scores of a submission: errors of forces, overlaps, times, and bounds over errors.

A submission is an ``.npz`` of arrays by ``scene/name``. It needs no code of this package: any
method that answers the test points of the data set may write one.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple
from zipfile import BadZipFile

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from hhr_dolfinx.errors import FileContentError, FileError
from hhr_dolfinx.files import read_arrays

ANSWERS_FORMAT = "hhr_dolfinx test answers"
ANSWERS_VERSION = 1
PRESENT = "forces", "bound", "offline_hours", "online_us"
"""Names of a scene in a submission; the first is needed."""


class HiddenAnswers(NamedTuple):
    """Exact answers of a scene at its test points.

    Attributes:
        forces: forces, (n, m), of histories (n, steps, m).
        floor: size of forces below which errors are not relative.
        stiffness: K, (N, N); None where it depends on parameters, or answers on paths.
        contact: B, (m, N).
        slack: slack without contact forces, (n, m).
    """

    forces: np.ndarray
    floor: float
    stiffness: csc_matrix | None = None
    contact: csc_matrix | None = None
    slack: np.ndarray | None = None


def read_hidden(path: Path) -> HiddenAnswers:
    """Hidden answers of a scene.

    Raises:
        FileError, FileContentError: for files that are not there, or not of this kind.
    """
    _, arrays = read_arrays(path, ANSWERS_FORMAT, ANSWERS_VERSION)
    if "stiffness_data" not in arrays:
        return HiddenAnswers(arrays["forces"], float(arrays["floor"]))
    stiffness, contact = (_matrix(arrays, name) for name in ("stiffness", "contact"))
    return HiddenAnswers(
        arrays["forces"], float(arrays["floor"]), stiffness, contact, arrays["slack"]
    )


def _matrix(arrays: dict[str, np.ndarray], name: str) -> csc_matrix:
    """A sparse matrix by its arrays."""
    parts = tuple(arrays[f"{name}_{part}"] for part in ("data", "indices", "indptr"))
    return csc_matrix(parts, shape=tuple(arrays[f"{name}_shape"].tolist()))


def score_submission(submission: str | Path, answers: str | Path) -> dict[str, dict[str, float]]:
    """Scores by scene and name.

    ``forces_p95`` and ``forces_worst`` are errors over the norm of the exact forces, or over the
    floor of the scene; ``overlap_p95`` the deepest overlap over the deepest one without forces;
    ``unanswered`` the number of test points that are NaN; ``exceeded`` how many errors are above
    their bound, ``effectivity`` the median of bound over error.

    Args:
        submission: ``.npz`` with ``scene/forces`` (n, m), of histories (n, steps, m), NaN where
            there is no answer; and if known ``scene/bound`` (n,), of the Euclidean norm of the
            error of all forces of a test point, ``scene/offline_hours`` and ``scene/online_us``.
        answers: folder of the hidden answers, ``scene.npz`` each.

    Raises:
        FileError, FileContentError: for files that are not there, damaged, or of other shapes.
    """
    folder = Path(answers)
    hidden = {path.stem: path for path in sorted(folder.glob("*.npz"))}
    if not hidden:
        raise FileError(
            f"{folder} has no hidden answers, scene.npz each: give the folder hidden of the data "
            "set"
        )
    given = _read_submission(Path(submission), set(hidden))
    return {
        scene: _score(given[scene], read_hidden(hidden[scene]), scene)
        for scene in hidden
        if scene in given
    }


def _read_submission(path: Path, scenes: set[str]) -> dict[str, dict[str, np.ndarray]]:
    """Arrays of a submission by scene and name."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise FileError(f"there is no file {path}") from None
    except (OSError, ValueError, EOFError, BadZipFile) as error:
        raise FileContentError(f"{path} is no .npz of arrays: {error}") from error
    found: dict[str, dict[str, np.ndarray]] = {}
    for name, array in arrays.items():
        scene, _, entry = name.partition("/")
        if scene not in scenes or entry not in PRESENT:
            raise FileContentError(
                f"{path} has '{name}': names are SCENE/NAME, SCENE of {', '.join(sorted(scenes))}, "
                f"NAME of {', '.join(PRESENT)}"
            )
        if array.dtype.kind not in "fiu":
            raise FileContentError(f"'{name}' of {path} is {array.dtype}, not numbers")
        found.setdefault(scene, {})[entry] = array.astype(float)
    for scene, entries in found.items():
        if "forces" not in entries:
            raise FileContentError(f"{path} has no '{scene}/forces'")
    return found


def _score(given: Mapping[str, np.ndarray], hidden: HiddenAnswers, scene: str) -> dict[str, float]:
    """Scores of a scene."""
    forces = given["forces"]
    if forces.shape != hidden.forces.shape:
        raise FileContentError(
            f"'{scene}/forces' is {forces.shape}, and the test points ask for {hidden.forces.shape}"
        )
    points = len(forces)
    there = np.isfinite(forces).reshape(points, -1).all(axis=1)
    off = np.linalg.norm(np.nan_to_num(forces) - hidden.forces, axis=-1)
    sizes = np.maximum(np.linalg.norm(hidden.forces, axis=-1), hidden.floor)
    # of a history its worst step
    errors = np.where(there, (off / sizes).reshape(points, -1).max(axis=1), np.inf)
    score = {
        "forces_p95": float(np.percentile(errors, 95, method="higher")),
        "forces_worst": float(errors.max()),
        "unanswered": int((~there).sum()),
    }
    if hidden.stiffness is not None and hidden.slack is not None and there.any():
        score["overlap_p95"] = _overlap(forces[there], hidden, hidden.slack[there])
    if "bound" in given:
        bound = given["bound"]
        if bound.shape != (points,):
            raise FileContentError(f"'{scene}/bound' is {bound.shape}, not ({points},)")
        whole = np.linalg.norm(off.reshape(points, -1), axis=1)
        compared = there & np.isfinite(bound) & (whole > 0)
        score["exceeded"] = int((whole[compared] > bound[compared] * (1 + 1e-9)).sum())
        if compared.any():
            score["effectivity"] = float(np.median(bound[compared] / whole[compared]))
    for name in ("offline_hours", "online_us"):
        if name in given:
            if given[name].size != 1:
                raise FileContentError(f"'{scene}/{name}' has {given[name].size} numbers, not one")
            score[name] = float(given[name].item())
    return score


def _overlap(forces: np.ndarray, hidden: HiddenAnswers, slack: np.ndarray) -> float:
    """95th percentile of the deepest overlap, over the deepest one of the scene without forces."""
    assert hidden.stiffness is not None and hidden.contact is not None and hidden.slack is not None
    change = splu(hidden.stiffness).solve(hidden.contact.T @ forces.T)
    left = slack + (hidden.contact @ change).T
    deepest = np.maximum(-left.min(axis=1), 0.0)
    return float(np.percentile(deepest, 95, method="higher") / max(-hidden.slack.min(), 1e-300))
