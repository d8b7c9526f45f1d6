"""Bolts that are shortened or pulled at a section through their shank."""

from dataclasses import replace

import numpy as np
import pytest
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileContentError, SceneError

AREA, LENGTH, YOUNG = 1.0, 3.0, 1000.0


def column(path, order=1, slope=0.0):
    """A column of 1 x 1 x 3 with 1 x 1 x 3 cells whose nodes in the middle are a set, CUT."""
    shift = lambda x, z: z + (slope * (x - 0.5) if 0.9 < z < 2.1 else 0.0)  # noqa: E731
    step = 1.0 / order
    axes = [
        np.arange(0, 1 + step / 2, step),
        np.arange(0, 1 + step / 2, step),
        np.arange(0, LENGTH + step / 2, step),
    ]
    number, rows = {}, ["*NODE"]
    for place in ((x, y, z) for z in axes[2] for y in axes[1] for x in axes[0]):
        if sum(abs(c - round(c)) > 1e-9 for c in place) < 2:  # corners and middles of edges
            number[tuple(np.round(place, 6))] = len(number) + 1
            rows.append(f"{len(number)}, {place[0]}, {place[1]}, {shift(place[0], place[2])}")
    corners = [
        (0, 0, 0),
        (1, 0, 0),
        (1, 1, 0),
        (0, 1, 0),
        (0, 0, 1),
        (1, 0, 1),
        (1, 1, 1),
        (0, 1, 1),
    ]
    edges = [
        (0, 1),
        (1, 2),
        (2, 3),
        (3, 0),
        (4, 5),
        (5, 6),
        (6, 7),
        (7, 4),
        (0, 4),
        (1, 5),
        (2, 6),
        (3, 7),
    ]
    rows.append(f"*ELEMENT, TYPE=C3D{8 if order == 1 else 20}, ELSET=BOLT")
    for k in range(3):
        own = [np.add(c, (0.0, 0.0, k)) for c in corners]
        own += [(own[a] + own[b]) / 2 for a, b in edges] if order == 2 else []
        rows.append(", ".join(map(str, [k + 1, *(number[tuple(np.round(p, 6))] for p in own)])))
    cut = [n for place, n in number.items() if place[2] == 1.0]
    rows += ["*NSET, NSET=CUT", ", ".join(map(str, cut))]
    for name, face, cell in (("FOOT", 1, 1), ("HEAD", 2, 3), ("LEFT", 6, None), ("FRONT", 3, None)):
        rows += [f"*SURFACE, NAME={name}"] + [
            f"{n}, S{face}" for n in ([cell] if cell else (1, 2, 3))
        ]
    path.write_text("\n".join(rows) + "\n")
    return path


def scene(path, constraints=(), loads=(), gap=0.0, ways=("p", 0.1, 1.0), sections=("CUT",)):
    """The column held at its foot, its sides sliding, below a plate at its head that is ``gap``
    away; no friction.
    """
    sides = hhr.Displacement("LEFT", 0), hhr.Displacement("FRONT", 1), hhr.Displacement("FOOT", 2)
    name, low, high = ways
    return hhr.Scene(
        name="bolt",
        geometry=hhr.CutMesh(path, sections=sections),
        hypothesis="solid",
        bodies=(hhr.Body("BOLT", young=YOUNG, poisson=0.3),),
        contacts=(hhr.Obstacle("HEAD", normal=(0, 0, 1), offset=LENGTH + gap),),
        displacements=sides,
        loads=loads,
        constraints=constraints,
        parameters=hhr.ParameterSpace((name,), (low,), (high,)),
        outputs=(
            hhr.ContactForce("plate", contact=0, direction=(0.0, 0.0, 1.0)),
            hhr.DisplacementAt("head", (0.0, 0.0, LENGTH), 2),
        ),
    )


@pytest.mark.parametrize("order", [1, pytest.param(2, marks=needs("second_order"))])
def test_a_bolt_without_resistance_gets_shorter(order, tmp_path):
    """By the shortening, without any stress."""
    path = column(tmp_path / "bolt.inp", order)
    full = hhr.FullOrderModel(scene(path, (hhr.Preload("CUT", "0.01 * p"),)))
    answer = full.solve(0.5)
    assert answer.outputs()["head"] == pytest.approx(-0.005, abs=1e-12)
    assert answer.stress() == pytest.approx(0 * answer.stress(), abs=1e-9)


@pytest.mark.filterwarnings("ignore:kappa")
@pytest.mark.parametrize("order", [1, pytest.param(2, marks=needs("second_order"))])
def test_a_bolt_pushed_apart_presses_the_plate(order, tmp_path):
    """A negative shortening against a plate: force E A (δ - gap) / L, in full, condensed and
    hyper-reduced models.
    """
    path = column(tmp_path / "bolt.inp", order)
    training = hhr.train(
        scene(path, (hhr.Preload("CUT", "-0.01 * p"),), gap=0.002), hhr.Sobol(8), held_out=2
    )
    for model in (training.full_order, hhr.condense(training.full_order), training.build()):
        found = model.solve(0.8).outputs()
        assert abs(found["plate"]) == pytest.approx(
            YOUNG * AREA * (0.008 - 0.002) / LENGTH, rel=1e-6
        )
        assert model.solve(0.15).outputs()["plate"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.filterwarnings("ignore:kappa")
@needs("moduli")
def test_the_modulus_of_a_bolt_may_be_a_parameter(tmp_path):
    """The force on the plate is E A (δ - gap) / L for any E, also with the modulus of a spring
    beside it.
    """
    path = column(tmp_path / "bolt.inp")
    varied = {"parameters": hhr.ParameterSpace(("p", "E"), (0.1, 500.0), (1.0, 2000.0))}
    made = scene(path, (hhr.Preload("CUT", "-0.01 * p"),), gap=0.002)
    made = replace(made, bodies=(hhr.Body("BOLT", young="E", poisson=0.3),), **varied)
    for loads, spring in (((), 0.0), ((hhr.Springs("HEAD", 2, 50.0, bedding=True),), 50.0)):
        training = hhr.train(replace(made, loads=loads), hhr.Sobol(8), held_out=2)
        for model in (training.full_order, training.condense(), training.build()):
            for young in (700.0, 1900.0):
                plate = young * AREA * (0.008 - 0.002) / LENGTH - spring * 0.002
                assert abs(model.solve([0.8, young]).outputs()["plate"]) == pytest.approx(
                    plate, rel=1e-6
                )


@needs("elasticity")
def test_a_force_draws_the_sides_together(tmp_path):
    """The head is held by a spring: tension F everywhere, the shortening F L / (E A) + F / k, F a
    parameter.
    """
    path = column(tmp_path / "bolt.inp")
    spring = hhr.Springs("HEAD", 2, 50.0, bedding=True)
    loads = (hhr.BoltForce("CUT", "2 * p"), spring)
    full = hhr.FullOrderModel(scene(path, (hhr.ForcedSection("CUT"),), loads))
    answer = full.solve(0.5)
    assert answer.stress()[:, 2] == pytest.approx(np.full(3, 1.0 / AREA), rel=1e-9)
    assert answer.outputs()["head"] == pytest.approx(-1.0 / 50.0, rel=1e-9)


def test_a_section_that_is_no_section_is_refused(tmp_path):
    path = column(tmp_path / "bolt.inp")
    with pytest.raises(FileContentError, match="no section 'NONE'"):
        hhr.CutMesh(path, sections=("NONE",)).read()
    with pytest.raises(FileContentError, match="cells on one side alone"):
        hhr.CutMesh(path, sections=("FOOT",)).read()
    whole = scene(path, (hhr.Preload("CUT", "p"),), sections=())
    with pytest.raises(SceneError, match="no surface of the mesh is called 'CUT'"):
        hhr.FullOrderModel(whole)
    with pytest.raises(SceneError, match="must be a tuple"):
        hhr.CutMesh(path, sections="CUT")
    bent = replace(hhr.CutMesh(column(tmp_path / "bent.inp", slope=0.2)), sections=("CUT",)).read()
    assert len(bent.surfaces["CUT"]) == 1  # an inclined plane is flat


@pytest.mark.parametrize(
    "constraints", [(), (hhr.Preload("CUT", 0.0),), (hhr.ForcedSection("OTHER"),)]
)
def test_a_force_without_its_section_is_refused(constraints, tmp_path):
    """Else it would be a force at two nodes, or none at all."""
    with pytest.raises(SceneError, match="must follow: add ForcedSection"):
        scene(column(tmp_path / "bolt.inp"), constraints, (hhr.BoltForce("CUT", "p"),))
