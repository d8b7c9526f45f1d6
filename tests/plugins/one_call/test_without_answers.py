"""Boxes of which a part, or all, has no equilibrium or no small strains: what searches ask, say and
return.
"""

from dataclasses import replace

import pytest
from mpi4py import MPI
from needs import needs
from scenes import block_scene, pressed_block, slope, space

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import (
    NotOfferedError,
    NotSolvableError,
    SmallStrainWarning,
    StudyError,
    TrainingWarning,
)
from hhr_dolfinx.geometries import block
from hhr_dolfinx.timing import unannounced


def lying(lower, upper, young=50.0, **others):
    """A block on a floor under a pressure ``p``, which contact alone holds: one that is negative
    lifts it off.
    """
    return block_scene(
        "lying",
        {"p": (lower, upper), **others},
        young=young,
        contacts=(hhr.Obstacle(block.side(1, upper=False), (0.0, -1.0), 0.0),),
        displacements=(hhr.Displacement(block.side(0, upper=False), 0),),
        loads=(hhr.Pressure(block.side(1, upper=True), slope("p")),),
    )


def test_a_box_without_equilibrium_is_given_up_with_its_reason():
    """It took 518 full answers after the first four had none."""
    with pytest.raises(
        StudyError, match=r"too few points of the box .*none of 16 queries .*p = -.*Lower the"
    ) as caught:
        hhr.reduce(lying(-3.0, -1.0), progress=unannounced, comm=MPI.COMM_SELF)
    assert caught.value.reduction.full_answers == 16


@needs("floating", "moduli")
def test_a_training_that_must_fail_ends_early(monkeypatch):
    """Nine of ten points have no equilibrium, and a training, which no condensation spares, needs
    half of its own.
    """
    from hhr_dolfinx.plugins.moduli.condense import Condensation

    def refuse(self, task):
        raise NotOfferedError("none of these")

    monkeypatch.setattr(Condensation, "check", refuse)
    with pytest.raises(StudyError, match="too few points of the box") as caught:
        hhr.reduce(
            lying(-9.0, 1.0, young="E", E=(40.0, 60.0)), progress=unannounced, comm=MPI.COMM_SELF
        )
    assert caught.value.reduction.full_answers < 60


@needs("floating", "moduli")
def test_a_box_of_few_points_with_equilibrium_needs_few_answers():
    """Nine of ten points have none: a model without a training answers the tenth, where p is the
    force.
    """
    with pytest.warns(TrainingWarning, match="fresh queries have no answer"):
        model = hhr.reduce(
            lying(-9.0, 1.0, young="E", E=(40.0, 60.0)), progress=unannounced, comm=MPI.COMM_SELF
        )
    assert model.reduction.full_answers < 60
    assert model.solve([0.5, 50.0]).forces().sum() == pytest.approx(0.5, rel=1e-9)


@pytest.mark.filterwarnings("ignore:.* queries have no answer")
@pytest.mark.parametrize("lower", [-1.0, -4.0])
def test_condense_and_reduce_agree_on_a_box_with_points_without_equilibrium(lower):
    """In part of it the block lies on the floor: p on a width of 1 is the force, in closed form."""
    scene = lying(lower, 1.0)
    for model in (hhr.condense(scene), hhr.reduce(scene, progress=unannounced, comm=MPI.COMM_SELF)):
        assert model.solve(0.5).forces().sum() == pytest.approx(0.5, rel=1e-9)
        with pytest.raises(NotSolvableError):
            model.solve(-0.5)


@needs("small_strains")
def test_a_model_that_refuses_each_point_is_none():
    """A block of height 2 is pushed by a thousand of them."""
    pushed = pressed_block("plane_strain")
    with (
        pytest.warns(SmallStrainWarning),
        pytest.raises(StudyError, match="strains are above 1 in nearly all of the box"),
    ):
        hhr.reduce(with_box(pushed, 2000.0), progress=unannounced, comm=MPI.COMM_SELF)


@needs("small_strains")
def test_a_search_says_in_which_part_of_the_box_its_model_answers():
    """The strain is (push - gap) / 2, or (1 - nu / (1 - nu)) of it across: 1 at a push of 2.01,
    half of the box.
    """
    stages = []
    progress = lambda stage, share: stages.append(stage)  # noqa: E731
    with pytest.warns(SmallStrainWarning):
        model = hhr.reduce(
            with_box(pressed_block("plane_strain"), 4.02), progress=progress, comm=MPI.COMM_SELF
        )
    assert (
        stages[-1] == "strains in corners of the box"
    )  # it takes most of the time with friction, and was silent
    assert model.reduction.met and model.reduction.answered == pytest.approx(0.5, abs=0.05)
    assert "% of the box, and the model refuses the rest" in model.reduction.verdict


def with_box(scene, upper):
    """The scene with pushes from zero."""
    return replace(scene, parameters=space(push=(0.0, upper)))
