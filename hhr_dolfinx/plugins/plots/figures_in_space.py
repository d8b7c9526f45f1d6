"""Figures of answers in space: bodies with their stress, contact surfaces with pressure and status.

PyVista renders each view off screen; matplotlib joins them with titles and bars of colours.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.plugins.plots.contact_fields import OPEN, SLIDING, STATUS_NAMES
from hhr_dolfinx.plugins.plots.facets import contact_facets, outer_facets
from hhr_dolfinx.plugins.plots.grids import at_slaves, contact_surface, surface_of
from hhr_dolfinx.plugins.plots.picture import (
    BAR,
    COLOURS,
    Picture,
    colour_limits,
    in_unit,
    wrapped,
)

with extra("pictures", "pictures of answers in space"):
    import pyvista
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize
    from matplotlib.figure import Figure

WINDOW = 1400, 1150
"""Pixels of a view."""
FAR_BELOW = 0.95
"""End of the colours over the largest value, below which the label states that value."""
SHARP = 35.0
"""Angle in degrees between facets from which their edge is drawn."""
BODY_OPACITY = 0.08
"""Opacity of bodies around contact surfaces."""
OPEN_COLOUR = "#c9ced6"
STATUS_COLOURS = {0: OPEN_COLOUR, 1: "#2b6cb0", 2: "#dd6b20"}
STATUS_WORDS = STATUS_NAMES | {1: "sticking or closed"}
PRESSURES = "plasma"
AZIMUTHS = (1.0, -1.4), (-1.0, -1.4), (1.4, 1.0), (-1.4, 1.0)
VIEWS = [np.array([x, y, 0.8]) / np.linalg.norm((x, y, 0.8)) for x, y in AZIMUTHS]
"""Directions to the camera that are tried: each shows contact surfaces as its opposite does."""
LIGHTING = {"ambient": 0.55, "diffuse": 0.5, "specular": 0.0}
VIEW_WIDTH = 5.6
VIEW_HEIGHT = 5.4
LEAST_COLUMN_WIDTH = 4.2
"""Largest width and height of a view, and the least width of its column, in inches."""
ORIGIN = (-0.03, -0.05)
"""Position of the arrows along the axes, in parts of a view."""
MARGIN = 12
"""Pixels around the bodies of a view."""


class View(NamedTuple):
    """A rendered view: its image and title; colours, their largest value, label and extension."""

    image: np.ndarray
    title: str
    colours: str | ListedColormap
    largest: float
    label: str
    extend: str = "neither"


def figure_in_space(picture: Picture, title: str) -> Figure:
    """Figure of an answer in space.

    Args:
        picture: contents, lengths and stresses in the units of the scene.
        title: of the figure.
    """
    way = _view(picture)
    views = [_bodies(picture, way), _pressures(picture, way)]
    if (picture.statuses == SLIDING).any():
        views.append(_statuses(picture, way))
    tall = max(view.image.shape[0] / view.image.shape[1] for view in views)
    width = min(VIEW_WIDTH, VIEW_HEIGHT / tall)
    size = max(width, LEAST_COLUMN_WIDTH) * len(views), width * tall + 1.6
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(wrapped(title, size[0]))
    for axes, view in zip(figure.subplots(1, len(views)), views, strict=True):
        axes.imshow(view.image, interpolation="antialiased")
        axes.set_axis_off()
        axes.set_title(view.title, fontsize="medium")
        _add_triad(axes, way)
        named = isinstance(view.colours, str)
        ends = Normalize(0.0, view.largest) if named else Normalize(-0.5, view.largest)
        options: dict[str, str | float] = {"location": "bottom", "shrink": 0.85, "aspect": BAR}
        mapped = ScalarMappable(ends, view.colours)
        bar = figure.colorbar(mapped, ax=axes, label=view.label, extend=view.extend, **options)
        if not named:
            bar.set_ticks(list(STATUS_NAMES), labels=[STATUS_WORDS[key] for key in STATUS_NAMES])
    return figure


def _view(picture: Picture) -> np.ndarray:
    """Direction to the camera that shows most of contacts and of stressed outsides, (3,)."""
    points = picture.deformed.points
    contacts = range(len(picture.mesh.contacts))
    surfaces = [contact_facets(picture.mesh, contact) for contact in contacts]
    vectors = [_area_vectors(points, facets) for facets in surfaces]
    scores = np.zeros(len(VIEWS))
    for way, view in enumerate(VIEWS):
        scores[way] = sum(np.abs(areas @ view).sum() for areas in vectors)
    scores /= scores.max() or 1.0
    stressed = np.zeros(len(VIEWS))
    for body in range(picture.bodies):
        facets = outer_facets(picture.mesh, body)
        areas = _area_vectors(points, facets)
        values = picture.values[body][facets].mean(axis=1)
        for way, view in enumerate(VIEWS):
            stressed[way] += (values * np.maximum(areas @ view, 0.0)).sum()
    return VIEWS[int((scores + stressed / (stressed.max() or 1.0)).argmax())]


def _area_vectors(points: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Normals of facets with the length of twice their area, (f, 3)."""
    if not len(facets):
        return np.zeros((0, 3))
    corners = points[facets]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, -1] - corners[:, 0])


def _add_triad(axes: Axes, way: np.ndarray) -> None:
    """Arrows along x, y, z in the lower left corner of a view."""
    right = np.cross((0.0, 0.0, 1.0), way)
    right /= np.linalg.norm(right)
    up = np.cross(way, right)
    for name, axis in zip("xyz", np.eye(3), strict=True):
        end = np.array([axis @ right, axis @ up])
        look = {"xycoords": "axes fraction", "textcoords": "offset points"}
        axes.annotate("", ORIGIN, xytext=tuple(24 * end), arrowprops={"arrowstyle": "<-"}, **look)
        axes.annotate(name, ORIGIN, xytext=tuple(31 * end), ha="center", va="center", **look)


def _bodies(picture: Picture, way: np.ndarray) -> View:
    """Surfaces of the deformed bodies, coloured at their nodes."""
    mesh = picture.mesh
    points = picture.deformed.points
    surfaces = []
    for body in range(picture.bodies):
        surface = surface_of(points, outer_facets(mesh, body))
        surface.point_data["colour"] = picture.values[body][surface.point_data["node"]]
        surfaces.append(surface)
    all_values = np.concatenate([surface.point_data["colour"] for surface in surfaces])
    low, high, extend = colour_limits(_seen(surfaces, way))
    if high < FAR_BELOW * all_values.max():
        extend = "max"
    plotter = _plotter()
    for surface in surfaces:
        look: dict[str, str | tuple[float, float]] = {
            "scalars": "colour",
            "cmap": COLOURS,
            "clim": (low, high),
        }
        plotter.add_mesh(surface, show_scalar_bar=False, **look, **LIGHTING)
        _add_edges(plotter, surface)
    label = (
        picture.label if extend == "neither" else f"{picture.label}, up to {all_values.max():.3g}"
    )
    title = picture.scale_words or "bodies"
    return View(_rendered(plotter, way), title, COLOURS, high, label, extend)


def _seen(surfaces: list[pyvista.PolyData], way: np.ndarray) -> np.ndarray:
    """Values of surfaces in the pixels of a view, (pixels,): what is hidden takes no colours."""
    largest = max(float(np.nanmax(surface.point_data["colour"])) for surface in surfaces) or 1.0
    plotter = pyvista.Plotter(off_screen=True, window_size=WINDOW)
    plotter.set_background("red")
    for surface in surfaces:
        look: dict[str, str | tuple[float, float]] = {"cmap": "gray", "clim": (0.0, largest)}
        plotter.add_mesh(
            surface.copy(), scalars="colour", lighting=False, show_scalar_bar=False, **look
        )
    plotter.enable_parallel_projection()
    plotter.view_vector(way, viewup=(0.0, 0.0, 1.0))
    image = np.asarray(plotter.screenshot(None, return_img=True)).astype(int)
    plotter.close()
    grey = (image[..., 0] == image[..., 1]) & (image[..., 1] == image[..., 2])
    return largest * image[grey][:, 0] / 255 if grey.any() else np.array([largest])


def _pressures(picture: Picture, way: np.ndarray) -> View:
    """Contact surfaces coloured by pressure, grey where they are open, within faint bodies."""
    largest = picture.largest_pressure
    plotter = _plotter()
    _add_faint_bodies(plotter, picture)
    for contact in range(len(picture.mesh.contacts)):
        surface = contact_surface(picture.mesh, contact, picture.deformed.points)
        nodes = surface.point_data["node"]
        pressures = at_slaves(picture.mesh, contact, picture.pressures)[nodes]
        states = at_slaves(picture.mesh, contact, picture.statuses.astype(float))[nodes]
        shown = np.where(states == OPEN, np.nan, np.maximum(pressures, 0.0))
        surface.point_data["pressure"] = np.nan_to_num(np.maximum(pressures, 0.0))
        surface.point_data["shown"] = shown
        _add_pressed(plotter, surface, largest)
    closed = int((picture.statuses > OPEN).sum())
    total = int((picture.statuses >= OPEN).sum())
    label = f"contact pressure{in_unit(picture.mesh.stress)}"
    title = f"contact: {closed} of {total} nodes closed, grey is open"
    return View(_rendered(plotter, way), title, PRESSURES, largest, label)


def _add_pressed(plotter: pyvista.Plotter, surface: pyvista.PolyData, largest: float) -> None:
    """Facets with a closed node by pressure, and others in grey."""
    if not surface.n_lines and surface.n_verts == surface.n_points:
        plotter.add_mesh(
            surface,
            scalars="pressure",
            cmap=PRESSURES,
            clim=(0.0, largest),
            show_scalar_bar=False,
            point_size=9,
            render_points_as_spheres=True,
        )
        return
    faces = surface.regular_faces
    closed = np.isfinite(surface.point_data["shown"])[faces].any(axis=1)
    points = np.asarray(surface.points)
    if closed.any():
        pressed = pyvista.PolyData.from_regular_faces(points, faces[closed])
        pressed.point_data["pressure"] = surface.point_data["pressure"]
        look: dict[str, str | tuple[float, float]] = {"cmap": PRESSURES, "clim": (0.0, largest)}
        plotter.add_mesh(pressed, scalars="pressure", show_scalar_bar=False, **look, **LIGHTING)
    if not closed.all():
        open_facets = pyvista.PolyData.from_regular_faces(points, faces[~closed])
        plotter.add_mesh(open_facets, color=OPEN_COLOUR, **LIGHTING)


def _statuses(picture: Picture, way: np.ndarray) -> View:
    """Contact surfaces coloured by status: each facet by the largest of its nodes."""
    plotter = _plotter()
    _add_faint_bodies(plotter, picture)
    for contact in range(len(picture.mesh.contacts)):
        surface = contact_surface(picture.mesh, contact, picture.deformed.points)
        nodes = surface.point_data["node"]
        states = at_slaves(picture.mesh, contact, picture.statuses.astype(float))[nodes]
        points = np.asarray(surface.points)
        if not surface.n_lines and surface.n_verts == surface.n_points:
            for status, colour in STATUS_COLOURS.items():
                if (states == status).any():
                    plotter.add_mesh(points[states == status], color=colour, point_size=9)
            continue
        faces = surface.regular_faces
        of_faces = states[faces].max(axis=1)
        for status, colour in STATUS_COLOURS.items():
            if (of_faces == status).any():
                facets = pyvista.PolyData.from_regular_faces(points, faces[of_faces == status])
                plotter.add_mesh(facets, color=colour, **LIGHTING)
    colours = ListedColormap([STATUS_COLOURS[key] for key in STATUS_NAMES])
    return View(_rendered(plotter, way), "status of contact", colours, 2.5, "status")


def _plotter() -> pyvista.Plotter:
    """An empty view on white."""
    plotter = pyvista.Plotter(off_screen=True, window_size=WINDOW, lighting="light kit")
    plotter.set_background("white")
    return plotter


def _add_edges(plotter: pyvista.Plotter, surface: pyvista.PolyData) -> None:
    """Sharp edges of a body."""
    edges = surface.extract_feature_edges(
        feature_angle=SHARP, boundary_edges=True, non_manifold_edges=False, manifold_edges=False
    )
    if edges.n_cells:
        plotter.add_mesh(edges, color="#222222", line_width=2)


def _add_faint_bodies(plotter: pyvista.Plotter, picture: Picture) -> None:
    """Bodies through which the contact surfaces are seen."""
    for body in range(picture.bodies):
        surface = surface_of(picture.deformed.points, outer_facets(picture.mesh, body))
        plotter.add_mesh(surface, color="#8fa3bf", opacity=BODY_OPACITY)
        _add_edges(plotter, surface)


def _rendered(plotter: pyvista.Plotter, way: np.ndarray) -> np.ndarray:
    """Image of a view from a direction, (3,), without its white margins, (height, width, 3)."""
    plotter.enable_parallel_projection()
    plotter.view_vector(way, viewup=(0.0, 0.0, 1.0))
    plotter.enable_anti_aliasing("msaa", multi_samples=8)
    image = np.asarray(plotter.screenshot(None, return_img=True))
    plotter.close()
    ink = (image < 250).any(axis=2)
    rows = np.flatnonzero(ink.any(axis=1))
    columns = np.flatnonzero(ink.any(axis=0))
    if not rows.size:
        return image
    top = max(rows[0] - MARGIN, 0)
    left = max(columns[0] - MARGIN, 0)
    return image[top : rows[-1] + MARGIN, left : columns[-1] + MARGIN]
