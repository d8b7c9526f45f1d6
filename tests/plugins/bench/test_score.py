"""Scores of submissions to the data set, by hand, and the data set itself at its smallest."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from needs import needs
from scipy.sparse import csc_matrix

import hhr_dolfinx as hhr
from hhr_dolfinx.command.main import hhr as command
from hhr_dolfinx.errors import FileContentError, FileError
from hhr_dolfinx.files import write_arrays
from hhr_dolfinx.plugins.bench.score import ANSWERS_FORMAT, ANSWERS_VERSION

FORCES = np.array([[3.0, 4.0], [0.0, 1e-6], [6.0, 8.0]])


def hidden(folder, forces=FORCES, **more):
    folder.mkdir(exist_ok=True)
    header = {"format": ANSWERS_FORMAT, "version": ANSWERS_VERSION}
    write_arrays(folder / "block.npz", header, {"forces": forces, "floor": np.array(0.1)} | more)
    return folder


def submitted(path, **entries):
    np.savez(path, **{f"block/{name}": value for name, value in entries.items()})
    return path


def test_errors_are_relative_to_the_exact_forces_or_to_the_floor(tmp_path):
    answers = hidden(tmp_path / "hidden")
    forces = FORCES + np.array([[0.0, 0.5], [0.05, 0.0], [1.0, 0.0]])
    file = submitted(tmp_path / "mine.npz", forces=forces, online_us=12.0, offline_hours=0.5)
    (score,) = hhr.score_submission(file, answers).values()
    assert score["forces_worst"] == score["forces_p95"] == pytest.approx(0.5)  # of the floor
    assert score["unanswered"] == 0 and score["online_us"] == 12 and score["offline_hours"] == 0.5
    assert "overlap_p95" not in score and "effectivity" not in score


def test_points_without_an_answer_count_as_infinitely_wrong(tmp_path):
    forces = FORCES.copy()
    forces[1, 0] = np.nan
    file = submitted(tmp_path / "mine.npz", forces=forces)
    (score,) = hhr.score_submission(file, hidden(tmp_path / "hidden")).values()
    assert score["unanswered"] == 1 and score["forces_worst"] == np.inf


def test_bounds_are_held_against_errors(tmp_path):
    """Of the Euclidean norm; a third point is exact and says nothing."""
    forces = FORCES + np.array([[0.0, 0.5], [0.1, 0.0], [0.0, 0.0]])
    file = submitted(tmp_path / "mine.npz", forces=forces, bound=np.array([1.0, 0.05, 0.0]))
    (score,) = hhr.score_submission(file, hidden(tmp_path / "hidden")).values()
    assert score["exceeded"] == 1
    assert score["effectivity"] == pytest.approx(np.median([2.0, 0.5]))


def test_a_history_counts_by_its_worst_step(tmp_path):
    exact = np.ones((2, 3, 2))
    forces = exact.copy()
    forces[1, 2, 0] += 2**0.5 / 4
    file = submitted(tmp_path / "mine.npz", forces=forces, bound=np.array([1.0, 1.0]))
    (score,) = hhr.score_submission(file, hidden(tmp_path / "hidden", exact)).values()
    assert score["forces_worst"] == pytest.approx(0.25)
    assert score["effectivity"] == pytest.approx(1 / (2**0.5 / 4))


def test_overlaps_are_those_of_the_forces(tmp_path):
    """K = diag(2, 4), one contact on each dof: slack + λ / K, over the deepest one of no forces."""
    parts = {}
    for name, matrix in (("stiffness", np.diag([2.0, 4.0])), ("contact", np.eye(2))):
        sparse = csc_matrix(matrix)
        for part in ("data", "indices", "indptr"):
            parts[f"{name}_{part}"] = getattr(sparse, part)
        parts[f"{name}_shape"] = np.array(matrix.shape)
    slack = np.array([[-1.5, -1.0], [0.0, -2.5e-7], [-3.0, -2.0]])
    answers = hidden(tmp_path / "hidden", **parts, slack=slack)
    exact = submitted(tmp_path / "exact.npz", forces=FORCES)
    assert hhr.score_submission(exact, answers)["block"]["overlap_p95"] == pytest.approx(0.0)
    none = submitted(tmp_path / "none.npz", forces=0 * FORCES)
    assert hhr.score_submission(none, answers)["block"]["overlap_p95"] == pytest.approx(1.0)
    half = submitted(tmp_path / "half.npz", forces=0.5 * FORCES)
    assert hhr.score_submission(half, answers)["block"]["overlap_p95"] == pytest.approx(0.5)


def test_what_is_no_submission_is_refused_by_name(tmp_path):
    answers = hidden(tmp_path / "hidden")
    for entries, said in (
        ({"forces": FORCES[:2]}, r"\(2, 2\), and the test points ask for \(3, 2\)"),
        ({"bound": np.ones(3)}, "has no 'block/forces'"),
        ({"forces": FORCES, "bound": np.ones(2)}, r"not \(3,\)"),
        ({"forces": FORCES, "peak": np.ones(3)}, "'block/peak': names are SCENE/NAME"),
        ({"forces": np.array([["a"]])}, "not numbers"),
        ({"forces": FORCES, "online_us": np.ones(3)}, "has 3 numbers, not one"),
        ({"forces": np.array([None, {}], dtype=object)}, r"is no \.npz|pickle"),
    ):
        with pytest.raises(FileContentError, match=said):
            hhr.score_submission(submitted(tmp_path / "mine.npz", **entries), answers)
    (tmp_path / "text.npz").write_text("forces")
    with pytest.raises(FileContentError, match=r"is no \.npz"):
        hhr.score_submission(tmp_path / "text.npz", answers)
    whole = submitted(tmp_path / "whole.npz", forces=FORCES).read_bytes()
    for damaged in (b"", whole[:200], whole[:-30]):
        (tmp_path / "damaged.npz").write_bytes(damaged)
        with pytest.raises(FileContentError, match=r"is no \.npz"):
            hhr.score_submission(tmp_path / "damaged.npz", answers)
    with pytest.raises(FileError, match="there is no file"):
        hhr.score_submission(tmp_path / "missing.npz", answers)
    with pytest.raises(FileError, match="no hidden answers"):
        hhr.score_submission(tmp_path / "mine.npz", tmp_path / "empty")


def test_the_command_prints_and_writes_scores(tmp_path):
    answers = hidden(tmp_path / "hidden")
    file = submitted(tmp_path / "mine.npz", forces=FORCES)
    words = ["bench", "score", str(file), "--answers", str(answers)]
    done = CliRunner().invoke(command, [*words, "--out", str(tmp_path / "score.json")])
    assert done.exit_code == 0, done.output
    assert "forces p95" in done.output and "block" in done.output
    assert json.loads((tmp_path / "score.json").read_text())["block"]["forces_worst"] == 0
    submitted(file, forces=np.nan * FORCES)
    CliRunner().invoke(command, [*words, "--out", str(tmp_path / "score.json")])
    text = (tmp_path / "score.json").read_text()
    assert json.loads(text)["block"]["forces_worst"] is None and "Infinity" not in text
    wrong = CliRunner().invoke(command, [*words[:2], str(tmp_path / "no.npz"), *words[3:]])
    assert wrong.exit_code and "there is no file" in wrong.output


@needs("studies", "tables", "moduli", "nonmatching", "inelastic", "friction", "shapes", "mortar")
def test_the_data_set_scores_exact_answers_as_exact(tmp_path):
    """Files of two scenes at their smallest: K, B, loads and gaps solve the test points again, by
    non-negative least squares and without this package.
    """
    import data_set
    from scipy import linalg, optimize
    from scipy.sparse.linalg import spsolve

    for name in ("matching", "membrane"):
        made = data_set.SCENES[name](True, 3)
        data_set.write_scene(name, made, tmp_path / "data" / name, tmp_path / "hidden", quiet)
        with np.load(tmp_path / "data" / name / "problem.npz") as file:
            stiffness, contact = (
                csc_matrix(
                    tuple(file[f"{matrix}_{part}"] for part in ("data", "indices", "indptr")),
                    shape=file[f"{matrix}_shape"],
                )
                for matrix in ("stiffness", "contact")
            )
            loads, gaps = file["test_loads"], file["test_gaps"]
        schur = contact @ spsolve(stiffness, contact.T.tocsc()).toarray()
        root = linalg.cholesky((schur + schur.T) / 2)
        forces = []
        for load, gap in zip(loads, gaps, strict=True):
            slack = gap - contact @ spsolve(stiffness, load)
            right = linalg.solve_triangular(root, -slack, trans=1)
            forces.append(optimize.nnls(root, right)[0])
        np.savez(tmp_path / f"{name}.npz", **{f"{name}/forces": np.array(forces)})
        score = hhr.score_submission(tmp_path / f"{name}.npz", tmp_path / "hidden")[name]
        assert score["forces_worst"] < 1e-7 and score["overlap_p95"] < 1e-9
    sums = data_set.checksums(tmp_path / "data")
    assert len(sums) == 6 and all(len(value) == 64 for value in sums.values())


def quiet(_title):
    return lambda items: items
