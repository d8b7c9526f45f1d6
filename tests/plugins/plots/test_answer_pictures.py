"""Pictures of answers and histories, and data for PyVista: what they draw is what answers say."""

import dataclasses

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from scenes import block_scene, pair_scene, pressed_block, pressed_pair, slope, stacked

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.geometries import two_blocks

pytest.importorskip("matplotlib")
pyvista = pytest.importorskip("pyvista")

BODIES = (3.0, 0.3), (5.0, 0.2)
AT = {"push": 0.03, "slide": 0.01, "load": 0.05, "gap": 0.004}


def fitted(overlap=0.1):
    """Two blocks on each other as drawn, which overlap by an opening: a press fit."""
    faces = two_blocks.side(two_blocks.FIRST, 1, True), two_blocks.side(two_blocks.SECOND, 1, False)
    ends = two_blocks.side(two_blocks.FIRST, 1, False), two_blocks.side(two_blocks.SECOND, 1, True)
    return pair_scene(
        "fit",
        {"overlap": (0.0, overlap)},
        ((0.0, 0.0), (1.0, 1.0), (4, 4)),
        ((0.0, 1.0), (1.0, 2.0), (4, 4)),
        BODIES,
        contacts=(hhr.NodeToNode(*faces, (0.0, 1.0)),),
        displacements=[hhr.Displacement(tag, axis) for tag in ends for axis in (0, 1)],
        openings=(hhr.Opening(0, slope("overlap", -1.0)),),
    )


def positions(full, answer, scale):
    from hhr_dolfinx.plugins.plots.picture import Picture

    return Picture.of(answer, full, scale).deformed.points


@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_a_press_fit_is_drawn_closed(scale):
    """Facing nodes are at one place in the picture; displacements alone leave a gap."""
    full = hhr.FullOrderModel(fitted())
    answer = full.solve(0.1)
    points = positions(full, answer, scale)
    pairs = full.problem.whole_contact
    apart = pairs @ points.ravel()
    assert np.abs(pairs @ (full.problem.points.ravel() + answer.displacement())).max() > 0.05
    np.testing.assert_allclose(apart, 0.0, atol=1e-9 * scale)


def test_closed_surfaces_of_magnified_displacements_touch():
    """A gap in the mesh of 0.05 that contact closes, magnified ten times: no overlap of 0.45."""
    scene = stacked(2)
    faces = two_blocks.side(two_blocks.FIRST, 1, True), two_blocks.side(two_blocks.SECOND, 1, False)
    lifted = pair_scene(
        "lifted",
        {"push": (0.0, 0.1)},
        ((0.0, 0.0), (1.0, 1.0), (4, 4)),
        ((0.0, 1.05), (1.0, 2.05), (4, 4)),
        BODIES,
        contacts=(hhr.NodeToNode(*faces, (0.0, 1.0)),),
        displacements=[
            *hhr.Displacement.clamp(two_blocks.side(two_blocks.FIRST, 1, False), 2),
            hhr.Displacement(two_blocks.side(two_blocks.SECOND, 1, True), 0),
            hhr.Displacement(two_blocks.side(two_blocks.SECOND, 1, True), 1, slope("push", -1.0)),
        ],
    )
    assert scene.contacts
    full = hhr.FullOrderModel(lifted)
    answer = full.solve(0.08)
    points = positions(full, answer, 10.0)
    closed = answer.statuses() == 1
    assert closed.any()
    np.testing.assert_allclose(
        (full.problem.whole_contact @ points.ravel())[closed], 0.0, atol=1e-9
    )
    plain = full.problem.points.ravel() + 10 * answer.displacement()
    assert (full.problem.whole_contact @ plain)[closed].min() > 0.4


def test_stress_of_a_uniform_block_is_uniform_in_the_picture():
    """Recovered at nodes: von Mises' stress in plane strain, E' strain sqrt(1 - ν + ν²)."""
    answer = hhr.FullOrderModel(pressed_block("plane_strain", simplices=True)).solve(0.05)
    figure = answer.plot()
    stress = figure.axes[0].collections[0].get_array()
    size = 3.0 / 0.91 * 0.02 * np.sqrt(1 - 0.3 + 0.3**2)
    np.testing.assert_allclose(stress, size, rtol=1e-9)


def test_stress_jumps_between_bodies():
    """A stiff body beside a soft one: each has stress at its own nodes of the common line."""
    full = hhr.FullOrderModel(pressed_pair("plane_strain", ((1.0, 0.3), (50.0, 0.3)), cells=6))
    from hhr_dolfinx.plugins.plots.picture import Picture

    picture = Picture.of(full.solve(AT), full)
    below, above = picture.values
    assert np.isnan(below).any() and np.isnan(above).any()
    assert (np.isfinite(below) ^ np.isfinite(above)).all()


def test_pressure_starts_at_zero_and_contacts_have_names():
    figure = hhr.FullOrderModel(pressed_pair("plane_strain", BODIES, cells=6)).solve(AT).plot()
    surface = figure.axes[1]
    assert surface.get_legend() is None  # the title names a contact that is alone
    scene = pressed_pair("plane_strain", BODIES)
    assert surface.get_title() == " and ".join(map(str, scene.contacts[0].tags))
    assert surface.get_ylim()[0] == 0
    assert "push = 0.03" in figure.get_suptitle()


def test_a_scale_is_taken_or_refused(tmp_path):
    answer = hhr.FullOrderModel(pressed_pair("plane_strain", BODIES)).solve(AT)
    figure = answer.plot(tmp_path / "a.png", scale=3)
    assert figure.axes[0].get_title() == "displacements 3 times as large"
    with pytest.raises(ParameterError, match="scale = -1 must be a number from 0 on"):
        answer.plot(scale=-1)


@pytest.mark.parametrize("simplices", [False, True])
def test_data_of_pyvista(simplices):
    """Bodies and contact surfaces with the numbers of the answer; areas of the geometry."""
    full = hhr.FullOrderModel(
        pressed_pair("solid", BODIES, cells=3, simplices=simplices), MPI.COMM_SELF
    )
    answer = full.solve(AT)
    blocks = answer.to_pyvista()
    first, second, surface = (blocks[k] for k in range(3))
    for body in (first, second):  # nodes of DOLFINx's tetrahedra may go either way round
        sizes = body.compute_cell_sizes()["Volume"]
        assert np.abs(sizes).sum() == pytest.approx(1.0)
    assert surface.area == pytest.approx(1.0)
    slaves = full.problem.contact_slaves
    order = np.argsort(slaves)
    np.testing.assert_array_equal(surface["node"], slaves[order])
    np.testing.assert_array_equal(surface["contact_pressure"], answer.pressure()[order])
    np.testing.assert_array_equal(surface["gap"], answer.gaps()[order])
    np.testing.assert_array_equal(surface["status"], answer.statuses()[order])
    field = answer.displacement().reshape(-1, 3)
    for body in (first, second):
        np.testing.assert_array_equal(body["displacement"], field[body["node"]])
        assert body["stress_kelvin"].shape == (body.n_points, 6) and body["von_mises"].min() > 0


@needs("second_order", "floating")
def test_facets_of_second_order_are_split():
    """Their parts have the area of the surface, and use all nodes that carry conditions."""
    from hhr_dolfinx.plugins.plots.facets import contact_facets, outer_facets

    scene = dataclasses.replace(stacked(3, simplices=True), order=2)
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    mesh = full.answer_mesh()
    facets = outer_facets(mesh, 0)
    corners = mesh.points[facets]
    areas = (
        np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )
        / 2
    )
    assert areas.sum() == pytest.approx(6.0)
    assert len(facets) == 4 * len(outer_facets(mesh, 0, split=False))
    assert len(contact_facets(mesh, 0)) > 0


@needs("friction")
def test_a_picture_in_space_has_a_view_of_statuses(tmp_path):
    from sheared_blocks import rubbing

    full = hhr.FullOrderModel(rubbing(dimension=3, cells=3), MPI.COMM_SELF)
    path = [(0.0, (0.0, 0.0)), (1.0, (0.03, 0.0)), (2.0, (0.03, 0.06))]
    answer = full.march(path).answers[-1]
    figure = answer.plot(tmp_path / "space.png")
    titles = [axes.get_title() for axes in figure.axes]
    assert (
        any("nodes closed, grey is open" in title for title in titles)
        and "status of contact" in titles
    )
    assert (tmp_path / "space.png").stat().st_size > 20_000
    images = [image.get_array() for axes in figure.axes for image in axes.get_images()]
    # colours beside white, grey and black: the views are not empty
    for image in images[:3]:
        assert (np.ptp(np.asarray(image, dtype=int), axis=2) > 40).mean() > 0.01


def test_outputs_of_a_history_over_time_and_over_each_other(tmp_path):
    """Curves have the outputs of the steps; small ones have a panel of their own."""
    scene = block_scene(
        "loop",
        {"down": (0.0, 1.0)},
        young=3.0,
        contacts=(hhr.Obstacle(two_blocks_free(), (0.0, -1.0), 0.1),),
        displacements=(
            hhr.Displacement(top_of_block(), 0),
            hhr.Displacement(top_of_block(), 1, slope("down", -1.0)),
        ),
        outputs=(
            hhr.ContactForce("force", 0, (0.0, 1.0), unit="N"),
            hhr.LargestPressure("peak", 0, unit="N"),
            hhr.ContactWidth("width", 0, unit="mm"),
        ),
    )
    history = hhr.FullOrderModel(scene).march([(float(k), [0.03 * k]) for k in range(9)])
    values = [answer.outputs() for answer in history.answers]
    figure = history.plot(tmp_path / "h.png")
    force, width = figure.axes
    assert force.get_ylabel() == "[N]" and width.get_ylabel() == "width [mm]"
    assert width.get_xlabel() == "time [s]" and (tmp_path / "h.png").stat().st_size > 5000
    np.testing.assert_array_equal(
        force.get_lines()[0].get_ydata(), [item["force"] for item in values]
    )
    (axes,) = history.plot(y="force", x="down").axes
    np.testing.assert_allclose(axes.get_lines()[0].get_xdata(), 0.03 * np.arange(1, 9))
    (axes,) = history.plot(y=["peak"], x="force").axes
    assert axes.get_xlabel() == "force [N]"
    with pytest.raises(
        ParameterError, match="a history has no 'strain': there are time, down, force, peak, width"
    ):
        history.plot(y="strain")


def two_blocks_free():
    from hhr_dolfinx.geometries import block

    return block.side(1, False)


def top_of_block():
    from hhr_dolfinx.geometries import block

    return block.side(1, True)
