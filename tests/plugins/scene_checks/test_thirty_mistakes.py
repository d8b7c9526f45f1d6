"""Typical mistakes in a scene of one's own: each is told, by its name, and with what to do."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import your_scene
from needs import needs
from second_order import rings

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.online.model_file import load_model
from hhr_dolfinx.plugins.scene_checks.check import check_scene
from hhr_dolfinx.plugins.scene_checks.findings import OK

MESH, UNITS, Pair, Slope = your_scene.MESH, your_scene.UNITS, hhr.NodeToSurface, hhr.Amplitude
ROLLER, STOP = Pair("roller_round", "spring_top"), Pair("stop_round", "spring_bottom")
Change = Callable[[hhr.Scene], Any]


@dataclass(frozen=True)
class Altered(hhr.MeshFile):
    """The mesh of a file after someone has spoilt it."""

    change: Callable[[RawMesh], RawMesh] = lambda raw: raw

    def read(self) -> RawMesh:
        return self.change(super().read())


def of(**changes: Any) -> Change:
    return lambda scene: replace(scene, **changes)


def body(place: int, **changes: Any) -> Change:
    return lambda scene: replace(
        scene,
        bodies=tuple(
            replace(one, **changes) if k == place else one for k, one in enumerate(scene.bodies)
        ),
    )


def paired(*surfaces: str, **how: Any) -> Change:
    return lambda scene: replace(scene, contacts=(Pair(*surfaces, **how), STOP))


def pressed(*given: Any) -> Change:
    return lambda scene: replace(scene, loads=(hhr.Pressure(*given),))


def displaced(*given: Any, without: str = "") -> Change:
    """Displacements but those of a tag, and another one."""
    return lambda scene: replace(
        scene,
        displacements=(
            *(item for item in scene.displacements if item.tag != without),
            *([hhr.Displacement(*given)] if given else []),
        ),
    )


def box(*bounds: Any) -> Change:
    return lambda scene: replace(scene, parameters=hhr.ParameterSpace(*bounds))


def mesh(change: Callable[[RawMesh], RawMesh]) -> Change:
    return lambda scene: replace(scene, geometry=Altered(MESH, change=change))


def file(path: Path | str) -> Change:
    return of(geometry=hhr.MeshFile(path))


def nodes_of(raw: RawMesh, name: str) -> np.ndarray:
    return np.unique(raw.cells[raw.bodies[name]])


def moved(name: str, by: tuple[float, float]) -> Change:
    return mesh(lambda raw: shifted(raw, nodes_of(raw, name), by))


def shifted(raw: RawMesh, nodes: Any, by: Any) -> RawMesh:
    points = raw.points.copy()
    points[nodes] += by
    return replace(raw, points=points)


def an_inner_facet(raw: RawMesh) -> RawMesh:
    points, cells = raw.points, raw.cells[raw.bodies["spring"]]
    cell = cells[np.linalg.norm(points[cells].mean(axis=1) - [32.0, 2.0], axis=1).argmin()]
    return replace(raw, surfaces={**raw.surfaces, "inside": cell[None, :2]})


def cut_in_two(raw: RawMesh) -> RawMesh:
    """The spring meshed in two volumes whose common nodes nobody merged."""
    middles = raw.points[raw.cells].mean(axis=1)[:, 0]
    own = np.isin(np.arange(len(raw.cells)), raw.bodies["spring"])
    right, left = own & (middles > 20), own & (middles <= 20)
    shared = np.intersect1d(raw.cells[right], raw.cells[left])
    twin = np.arange(len(raw.points))
    twin[shared] = len(raw.points) + np.arange(shared.size)
    cells = raw.cells.copy()
    cells[right] = twin[cells[right]]
    surfaces = {name: facets.copy() for name, facets in raw.surfaces.items()}
    for name in ("spring_top", "spring_bottom"):
        beyond = raw.points[surfaces[name]].mean(axis=1)[:, 0] > 20
        surfaces[name][beyond] = twin[surfaces[name][beyond]]
    return replace(
        raw, points=np.vstack([raw.points, raw.points[shared]]), cells=cells, surfaces=surfaces
    )


def glued_at_a_node(raw: RawMesh) -> RawMesh:
    """Duplicate nodes removed where roller and spring touch."""
    first, second = (np.unique(raw.surfaces[name]) for name in ("roller_round", "spring_top"))
    distances = np.linalg.norm(raw.points[first][:, None] - raw.points[second], axis=2)
    place = np.unravel_index(distances.argmin(), distances.shape)
    merged = np.arange(len(raw.points))
    merged[first[place[0]]] = second[place[1]]
    surfaces = {name: merged[facets] for name, facets in raw.surfaces.items()}
    return replace(raw, cells=merged[raw.cells], surfaces=surfaces).compact()


def folded(raw: RawMesh) -> RawMesh:
    inner = np.setdiff1d(nodes_of(raw, "spring"), np.concatenate(list(raw.surfaces.values())))
    return shifted(
        raw, inner[np.abs(raw.points[inner] - [20.0, 2.0]).sum(axis=1).argmin()], [4.0, 0.5]
    )


def flattened(raw: RawMesh) -> RawMesh:
    cell = raw.cells[raw.bodies["spring"][100]]
    return shifted(raw, cell[0], raw.points[cell[1:]].mean(axis=0) - raw.points[cell[0]])


def without_names(raw: RawMesh) -> RawMesh:
    """As gmsh writes physical groups without a name."""
    bodies = dict(enumerate(raw.bodies.values(), start=1))
    return replace(raw, bodies=bodies, surfaces=dict(enumerate(raw.surfaces.values(), start=11)))


def without_surface(raw: RawMesh) -> RawMesh:
    return replace(
        raw, surfaces={name: facets for name, facets in raw.surfaces.items() if name != "clamp"}
    )


def without_group(raw: RawMesh) -> RawMesh:
    lost = set(raw.bodies["stop"])
    return replace(
        raw, bodies={name: cells for name, cells in raw.bodies.items() if not lost & set(cells)}
    )


def pascals_and_megapascals(scene: hhr.Scene) -> hhr.Scene:
    """A modulus in Pa beside others in MPa, where no units are said."""
    return replace(body(0, young=210e9)(scene), units=None)


TRAVEL = ("travel", "lowered")
MISTAKES: dict[str, tuple[Change, str]] = {
    # names
    "a surface is misspelt": (
        paired("roller_rond", "spring_top"),
        r"'roller_rond'.*Is 'roller_round' meant\?",
    ),
    "a body is misspelt": (body(0, tag="sprng"), r"'sprng'.*Is 'spring' meant\?"),
    "a body as a surface": (
        paired("roller", "spring_top"),
        r"'roller'.*is a body of it: a surface is needed here",
    ),
    "a surface as a body": (
        body(1, tag="roller_round"),
        r"'roller_round'.*is a surface of it: a body is needed here",
    ),
    "a body is forgotten": (
        lambda scene: replace(scene, bodies=scene.bodies[:2]),
        r"'stop'.*give each a Body",
    ),
    "a body is listed twice": (
        lambda scene: replace(scene, bodies=(*scene.bodies, scene.bodies[0])),
        r"tag spring: .*List each body once",
    ),
    "a scene with a blank": (of(name="leaf spring"), r"'leaf spring'.*Call it 'leaf_spring'"),
    # supports
    "a clamp is forgotten": (
        displaced(without="clamp"),
        r"body spring .*moves along axis 0.*hold it by a Displacement",
    ),
    "a surface that nothing names": (
        displaced(without="clamp"),
        r"surfaces that nothing names: clamp",
    ),
    "a clamp that is not unpacked": (
        of(displacements=(hhr.Displacement.clamp("clamp", 2),)),
        r"displacements\[0\].*Put a star before it",
    ),
    "component 2 in the plane": (
        displaced("clamp", 2),
        r"component 2 .* on tag clamp .*take a component below",
    ),
    "a component as a letter": (
        displaced("clamp", "y"),
        r"component 'y' .* on tag clamp must be 0, 1 or 2",
    ),
    "a displacement given twice": (
        displaced("roller_flat", 1, Slope(0.5)),
        r"5 on tag roller_flat and 6 .*component 1 at .*leave one of them out",
    ),
    "a displacement on a body": (
        displaced("stop", 1),
        r"'stop' is a body of it: a surface is needed here",
    ),
    "a displacement as text": (
        displaced("roller_flat", 1, "0.3 mm", without="roller_flat"),
        r"amplitude of the displacement on tag roller_flat: the formula '0.3 mm'",
    ),
    # contacts
    "a pair listed twice": (
        paired("spring_bottom", "stop_round"),
        r"contacts 0 and 1 .*'stop_round'.*List each pair once",
    ),
    "a surface with itself": (
        paired("roller_round", "roller_round"),
        r"contact 0 .* roller_round with itself.*Name the surface of the other body",
    ),
    "the back of the roller": (
        paired("roller_flat", "spring_top"),
        r"roller_flat and spring_top never face.*Check the tags",
    ),
    "partners mixed up": (
        of(contacts=(Pair("roller_round", "spring_bottom"), Pair("stop_round", "spring_top"))),
        r"stop_round and spring_top never face.*Check the tags",
    ),
    "a normal the wrong way": (
        paired("roller_round", "spring_top", normal=(0.0, 1.0)),
        r"roller_round .*should look along .*Swap the surfaces or the sign",
    ),
    "bodies far apart": (
        moved("roller", (500.0, 0.0)),
        r"roller_round and spring_top never face.*Check the tags",
    ),
    "bodies drawn into each other": (
        moved("roller", (0.0, -3.0)),
        r"'roller_round' and 'spring_top': bodies overlap by 3 mm .*Move them apart",
    ),
    "a gap below the sag": (
        moved("stop", (0.0, 0.19)),
        r"'stop_round' and 'spring_bottom': the smallest gap, 0.01 mm, .*Refine",
    ),
    "nodes in common": (
        mesh(glued_at_a_node),
        r"'roller_round' and 'spring_top' share 1 nodes.*Give each body separate nodes",
    ),
    "one contact without a tuple": (
        of(contacts=ROLLER),
        r"Scene.contacts .*write \(NodeToSurface\(\.\.\.\),\)",
    ),
    "a pair of names": (
        of(contacts=(("roller_round", "spring_top"),)),
        r"contacts\[0\] .*it must be a contact pair.*such as",
    ),
    "no contact": (
        of(contacts=(), openings=(), outputs=()),
        r"'leaf_spring'.*contacts=\(NodeToSurface",
    ),
    "an opening of contact 5": (
        of(openings=(hhr.Opening(5, Slope(slopes={"lowered": 1.0})),)),
        r"contact 5, .*name one of .*1 of \('stop_round', 'spring_bottom'\)",
    ),
    "an opening by a name": (
        lambda scene: hhr.Opening("stop_round", Slope(1.0)),
        r"'stop_round' of an opening must be the place of a pair",
    ),
    # materials and units
    "E in GPa": (
        body(0, young=210.0),
        r"'spring': E = 210 MPa is softer than plastics .*give E in MPa",
    ),
    "E in Pa": (body(0, young=210e9), r"'spring': E = 2.1e\+11 MPa .*give E in MPa"),
    "E in two units": (
        pascals_and_megapascals,
        r"'spring' with E = 2.1e\+11 .*body 'roller'.*give both in one unit",
    ),
    "E below zero": (
        body(2, young=-3000.0),
        r"body stop: young = -3000.0 must be positive.*E in the unit of stress",
    ),
    "E with its unit": (
        body(2, young="3000 MPa"),
        r"body stop: .*'3000 MPa'.*Write numbers without units",
    ),
    "E of a misspelt parameter": (
        body(2, young="E_stpo"),
        r"body stop: .*'E_stpo'.*correct the name",
    ),
    "nu of rubber": (body(2, poisson=0.5), r"body stop: .*poisson = 0.5 .*take nu = 0.499"),
    "nu in percent": (body(2, poisson=30), r"body stop: .*poisson = 30 .*not in percent: 0.3"),
    "aluminum": (
        lambda scene: hhr.Body.of("spring", "aluminum", UNITS),
        r"body spring: .*'aluminum', is 'aluminium' meant\?",
    ),
    "Mpa": (
        lambda scene: hhr.Units("mm", "Mpa"),
        r"'Mpa' of stress is unknown: take one of Pa, kPa, MPa",
    ),
    "units of no parameter": (of(parameter_units={"travl": "mm"}), r"is 'travel' meant\?"),
    "a unit that is no text": (
        of(parameter_units={"travel": 1e6}),
        r"must be texts by the names of parameters",
    ),
    "units as text": (of(units="mm"), r"units = 'mm' must be Units, such as Units\('mm', 'MPa'\)"),
    "a mesh in metres": (
        mesh(lambda raw: replace(raw, points=raw.points * 1e-3)),
        r"leaf_spring.msh is 0.06 x 0.0142 mm.*MeshFile\(path, scale=",
    ),
    "a travel beyond the mesh": (
        lambda scene: replace(
            mesh(lambda raw: replace(raw, points=raw.points * 1e-3))(scene), units=None
        ),
        r"displacement on 'roller_flat' reaches 1, .*bring parameters and mesh to one unit",
    ),
    # parameters
    "a parameter that nothing names": (
        box((*TRAVEL, "E1"), (0.05, 0.0, 1.0), (1.0, 0.3, 2.0)),
        r"parameters \('E1',\) .* have no effect.*Remove them",
    ),
    "a box the wrong way": (
        box(TRAVEL, (1.0, 0.0), (0.05, 0.3)),
        r"'travel' are 1 .. 0.05: swap them",
    ),
    "a box without extent": (
        box(TRAVEL, (0.05, 0.0), (1.0, 0.0)),
        r"'lowered' are 0 .. 0: .*a number where it is used",
    ),
    "a bound too few": (
        box(TRAVEL, (0.05,), (1.0, 0.3)),
        r"'travel', 'lowered'\) need .* have 1 and 2: give each",
    ),
    "a misspelt parameter moves": (
        displaced("roller_flat", 1, Slope(slopes={"travl": -1.0}), without="roller_flat"),
        r"'roller_flat'.*names \['travl'\].*correct the name",
    ),
    # loads
    "a pressure of an unknown parameter": (
        pressed("spring_top", Slope(slopes={"p": 1.0})),
        r"Pressure\(tag='spring_top'.*names \['p'\].*add it to the ParameterSpace",
    ),
    "a pressure by a misspelt formula": (
        pressed("spring_top", "2 * travl"),
        r"Pressure\(tag='spring_top'.*names \['travl'\].*correct the name",
    ),
    "a load inside the mesh": (
        lambda scene: pressed("inside", 1.0)(mesh(an_inner_facet)(scene)),
        r"tagged inside under a Pressure lie inside .*Tag the surface",
    ),
    "a load on a body": (
        pressed("spring", 1.0),
        r"'spring' is a body of it: a surface is needed here",
    ),
    "a load that is zero": (
        pressed("spring_top", 0.0),
        r"Pressure on 'spring_top' has the amplitude 0 .*give it another, or leave it out",
    ),
    "a traction in space": (
        of(loads=(hhr.Traction("spring_top", (0.0, 0.0, 1.0), 1.0),)),
        r"on tag spring_top must have 2 components, as the mesh",
    ),
    # hypothesis
    "plain strain": (
        of(hypothesis="plain_strain"),
        r"'plain_strain', one of plane_strain, .* is needed",
    ),
    "solid in the plane": (of(hypothesis="solid"), r"'solid' .*take plane_strain"),
    "across the axis": (
        lambda scene: replace(
            mesh(lambda raw: replace(raw, points=raw.points - [30.0, 0.0]))(scene),
            hypothesis="axisymmetric",
        ),
        r"axisymmetric mesh have r < 0, .*mesh one half of the section",
    ),
    # the mesh and its file
    "a path for a geometry": (
        of(geometry="leaf_spring.msh"),
        r"geometry = 'leaf_spring.msh' .*write MeshFile\('leaf_spring.msh'\)",
    ),
    "a file that is not there": (
        file(MESH.with_name("leaf_sprin.msh")),
        r"leaf_sprin.msh: .* has .*leaf_spring.msh",
    ),
    "a wrong ending": (
        file(MESH.with_suffix(".vtk")),
        r"leaf_spring.vtk: .* has .*leaf_spring.msh",
    ),
    "no mesh": (
        file(MESH.with_suffix(".py")),
        r"leaf_spring.py cannot be read.*in another format: .msh",
    ),
    "no names": (
        mesh(without_names),
        r"'clamp' is requested: name the physical groups .*or give their numbers",
    ),
    "an empty group": (mesh(without_surface), r"'clamp'.*give the mesh a group of this name"),
    "a body in no group": (
        lambda scene: replace(mesh(without_group)(scene), bodies=scene.bodies[:2]),
        r"640 cells have no tag.*Put them into a physical group",
    ),
    "cells of second order": (
        lambda scene: replace(rings(0.5, 2), order=1),
        r"are of second order, and order = 1: leave it out",
    ),
    "folded cells": (mesh(folded), r"at \[\d.*turned inside out. Mend the mesh there"),
    "a cell without volume": (
        mesh(flattened),
        r"cells of the mesh have no volume, e.g. .*mend the mesh there",
    ),
    "a body in two": (
        mesh(cut_in_two),
        r"body 'spring' falls apart: 3 of its nodes .*Merge these nodes",
    ),
    # outputs
    "an output of no body": (
        lambda scene: replace(scene, outputs=(hhr.VonMises("s", tag="sprig"),)),
        r"output 's'.*sprig .*name one of them",
    ),
    "two outputs of a name": (
        lambda scene: replace(scene, outputs=scene.outputs[:1] * 2),
        r"'force on the roller': give each a different name",
    ),
    "an output of no contact": (
        of(outputs=(hhr.LargestPressure("p", contact=2),)),
        r"output 'p' names contact 2, and the scene has 2: name one of 0, 1",
    ),
    "an output off the mesh": (
        of(outputs=(hhr.DisplacementAt("tip", (0.0, 40.0), 1),)),
        r"output 'tip': .* away from the nearest point.*move it",
    ),
}
"""What is changed in ``your_scene.scene()``, and a pattern of the object and of the remedy."""


NEEDED = {
    "an output of no body": ("stress",),
    "a clamp is forgotten": ("floating",),
    "cells of second order": ("mortar",),
}
"""Plug-ins whose parts a mistake is made with, or whose words it is told in."""


def told(change: Change) -> list[str]:
    """What is said of a changed scene: an error where it is written, or what a check of it
    finds.
    """
    try:
        scene = change(your_scene.scene())
    except HHRError as error:
        return [str(error)]
    return [finding.text for finding in check_scene(scene).findings if finding.level != OK]


@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=needs(*NEEDED.get(k, ()))) for k in MISTAKES]
)
def test_a_mistake_is_told_with_its_object_and_its_remedy(name):
    change, pattern = MISTAKES[name]
    texts = told(change)
    assert any(re.search(pattern, text) for text in texts), texts


@pytest.fixture(scope="module")
def trained():
    """A small model, taken as it is: good enough for what is said of questions."""
    training = hhr.train(your_scene.scene(), hhr.Sobol(8), held_out=0)
    return training.build(hhr.Recipe().as_it_is())


@pytest.mark.parametrize(
    ("question", "pattern"),
    [
        ((5.0, 0.0), r"travel = 5 is outside \[0.05, 1\]: .*choose a value inside"),
        ({"travl": 0.5, "lowered": 0.0}, r"'travel' is missing, 'travl' is unknown.*give each"),
        (0.5, r"'travel', 'lowered'\), got .*give a value for each"),
    ],
    ids=["outside of the box", "a misspelt name", "one value of two"],
)
def test_wrong_questions_to_a_model(trained, question, pattern):
    with pytest.raises(HHRError, match=pattern):
        trained.solve(question)


@pytest.mark.parametrize(
    ("points", "pattern"),
    [
        ((1, 1), r"'leaf_spring' on \(1, 1\) points: .*Give it more, Sobol\(64\)"),
        (hhr.Sobol(1), r"'leaf_spring' on Sobol\(.*Give it more, Sobol\(64\)"),
        ((4,), r"'leaf_spring': counts \(4,\) .*one for each of"),
    ],
    ids=["one point", "one of Sobol's", "one count"],
)
def test_wrong_trainings(points, pattern):
    with pytest.raises(HHRError, match=pattern):
        hhr.train(your_scene.scene(), points)


@needs("fallback", "exact_errors")
def test_a_model_of_another_scene(trained, tmp_path):
    path = tmp_path / "model.npz"
    hhr.save_model(path, trained)
    other = hhr.FullOrderModel(replace(body(2, young=2000.0)(your_scene.scene()), name="softer"))
    with pytest.raises(
        HHRError, match=r"another scene.*'softer': give the FullOrderModel of the scene that was"
    ):
        hhr.FallbackModel(load_model(path), other, 0.01)
    with pytest.raises(HHRError, match=r"leaf_spring.msh .*build the model again"):
        load_model(MESH)


def test_cad_is_no_mesh(tmp_path):
    path = tmp_path / "spring.step"
    path.write_text("ISO-10303-21;")
    (text,) = told(file(path))
    assert re.search(r"spring.step cannot be read.*mesh its volumes in gmsh", text)
