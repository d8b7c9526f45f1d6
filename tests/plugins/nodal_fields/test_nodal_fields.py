"""Fields at nodes of another program: as loads, and as parameters by a POD basis."""

import ctypes
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from scenes import block_scene, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import (
    FileContentError,
    OutsideTrainingWarning,
    ParameterError,
    SceneError,
)
from hhr_dolfinx.geometries import block

pytestmark = [
    needs("nodal_fields"),
    pytest.mark.filterwarnings("ignore:parameters .* have no effect"),
]
BOTTOM, TOP = (block.side(1, upper=upper) for upper in (False, True))
LEFT = block.side(0, upper=False)
RNG = np.random.default_rng(3)
EXPANSION = 1e-5
BOX = hhr.ParameterSpace(("push",), (0.0,), (2e-3,))


def heated(*loads, box=BOX, friction=None, **others):
    """A block on a floor, pushed down and heated."""
    return block_scene(
        "heated",
        {"push": (0.0, 2e-3)},
        upper=(2.0, 1.0),
        cells=(8, 4),
        contacts=(hhr.Obstacle(BOTTOM, normal=(0, -1), offset=1e-4, friction=friction),),
        displacements=(hhr.Displacement(TOP, 1, slope("push", -1.0)), hhr.Displacement(TOP, 0)),
        loads=loads,
        outputs=(hhr.ContactForce("force", 0, (0, 1)), hhr.LargestPressure("peak", 0)),
        parameters=box,
        **others,
    )


def full(scene):
    return hhr.FullOrderModel(scene, MPI.COMM_SELF)


def nodes():
    """Nodes of the block."""
    return full(heated()).problem.points


def fields_at(points, count=12):
    """Temperatures that a few numbers make: a source that moves, and its size."""
    x, y = points.T
    return np.array(
        [
            100 * size * np.exp(-((x - place) ** 2)) * (1 + 0.3 * y)
            for place, size in zip(
                np.linspace(0.3, 1.7, count), np.linspace(0.6, 1.4, count), strict=True
            )
        ]
    )


@pytest.mark.parametrize("order", [1, 2])
def test_values_at_nodes_are_a_formula(order):
    """A field that functions of the cells have, by its values and by a formula."""
    if order == 2:
        pytest.importorskip("hhr_dolfinx.plugins.second_order")
    points = nodes()
    formula = hhr.ThermalExpansion(block.SOLID, EXPANSION, 100.0, lambda x: 1 + x[0] - 0.4 * x[1])
    values = 1 + points[:, 0] - 0.4 * points[:, 1]
    shuffled = RNG.permutation(len(points))
    field = hhr.NodalField(points[shuffled], values[shuffled])
    given = hhr.ThermalExpansion(block.SOLID, EXPANSION, 100.0, field)
    expected, found = (
        full(heated(load, order=order)).solve({"push": 1e-3}) for load in (formula, given)
    )
    assert found.displacement() == pytest.approx(expected.displacement(), rel=1e-9, abs=1e-15)
    assert found.forces() == pytest.approx(expected.forces(), rel=1e-9, abs=1e-15)


def test_points_of_another_mesh_are_interpolated():
    """Linear between points that are no nodes, and exact for a linear field."""
    points = nodes()
    x, y = np.meshgrid(np.linspace(0, 2, 6), np.linspace(0, 1, 4))
    other = np.column_stack([x.ravel(), y.ravel()])
    field = hhr.NodalField(other, 3 + other @ [2.0, -1.0])
    assert field.at(points) == pytest.approx(3 + points @ [2.0, -1.0], rel=1e-12)
    assert field.at(np.array([[2.5, 0.0]]))[0] == 7.0  # beyond them that of the nearest


@pytest.mark.parametrize("made", [full, hhr.condense], ids=["full", "condensed"])
def test_a_field_is_a_point_of_parameters(made):
    """Answers at the amplitudes of a field are those of the field as one load."""
    points = nodes()
    given = fields_at(points)
    modes = hhr.FieldModes.of(points, given, tolerance=1e-6)
    assert 2 < len(modes.names) < 12
    model = made(heated(*modes.expansion(block.SOLID, EXPANSION), box=modes.joined(BOX)))
    for values in (given[4], 0.3 * given[1] + 0.5 * given[9]):
        load = hhr.ThermalExpansion(block.SOLID, EXPANSION, 1.0, hhr.NodalField(points, values))
        expected = full(heated(load)).solve({"push": 1e-3})
        found = model.solve({"push": 1e-3, **modes.amplitudes(values)}, outside="ignore")
        size = expected.forces().max()
        assert found.forces() == pytest.approx(expected.forces(), abs=1e-6 * size)
        assert modes.values(modes.amplitudes(values)) == pytest.approx(values, abs=1e-6)


def test_the_basis_is_as_small_as_the_tolerance_lets_it_be():
    points = nodes()
    given = fields_at(points)
    counts = []
    for tolerance in (10.0, 1.0, 1e-3):
        modes = hhr.FieldModes.of(points, given, tolerance=tolerance)
        worst = [np.abs(modes.left_out(values)).max() for values in given]
        assert max(worst) <= tolerance
        smaller = replace(modes, modes=modes.modes[:, :-1], lower=modes.lower[:-1])
        assert max(np.abs(smaller.left_out(values)).max() for values in given) > tolerance
        assert modes.modes.T @ modes.modes == pytest.approx(np.eye(len(modes.names)), abs=1e-12)
        counts.append(len(modes.names))
    assert counts == sorted(set(counts))


def test_a_field_that_modes_do_not_have_is_named():
    points = nodes()
    modes = hhr.FieldModes.of(points, fields_at(points), tolerance=1e-3)
    with pytest.warns(OutsideTrainingWarning, match="leave out .* more than 0.001"):
        modes.amplitudes(np.sin(20 * points[:, 1]))


@needs("friction")
def test_fields_along_a_path_with_friction():
    """A path of fields, as a fixed point of two programs in time gives them: that of a scene whose
    load has the fields as they are.
    """
    points = nodes()
    given = fields_at(points, 4)
    modes = hhr.FieldModes.of(points, given, tolerance=1e-9)
    box = modes.joined(BOX)
    model = hhr.condense(heated(*modes.expansion(block.SOLID, EXPANSION), box=box, friction=0.2))
    steps = [(0.0, {"push": 1e-3, **modes.amplitudes(given[0])})]
    steps += [(float(k), {"push": 1e-3, **modes.amplitudes(given[k])}) for k in (1, 2, 3)]
    last = model.march(steps).answers[-1]
    names = tuple(f"w{k}" for k in range(4))
    weights = hhr.ParameterSpace(("push", *names), (0.0,) + 4 * (-1.0,), (2e-3,) + 4 * (2.0,))
    loads = [
        hhr.ThermalExpansion(block.SOLID, EXPANSION, name, hhr.NodalField(points, values))
        for name, values in zip(names, given, strict=True)
    ]
    direct = hhr.condense(heated(*loads, box=weights, friction=0.2))
    chosen = [{"push": 1e-3, **dict.fromkeys(names, 0.0), f"w{k}": 1.0} for k in range(4)]
    expected = direct.march([(float(k), point) for k, point in enumerate(chosen)]).answers[-1]
    size = np.abs(expected.multipliers).max()
    assert last.multipliers == pytest.approx(expected.multipliers, abs=1e-8 * size)


def test_files_keep_modes(tmp_path):
    points = nodes()
    modes = hhr.FieldModes.of(points, fields_at(points), tolerance=0.1, name="heat")
    modes.save(tmp_path / "modes.npz")
    found = hhr.FieldModes.load(tmp_path / "modes.npz")
    assert found.names == modes.names and found.names[0] == "heat1"
    assert found.modes.tolist() == modes.modes.tolist() and found.tolerance == 0.1
    data = bytearray((tmp_path / "modes.npz").read_bytes())
    data[-300] ^= 1
    (tmp_path / "modes.npz").write_bytes(bytes(data))
    with pytest.raises(FileContentError):
        hhr.FieldModes.load(tmp_path / "modes.npz")


@needs("exporters")
def test_a_field_goes_through_c(tmp_path):
    """Compiled: a field, its amplitudes, and outputs at them."""
    from hhr_dolfinx.plugins.exporters import c_header

    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    points = nodes()
    given = fields_at(points)
    modes = hhr.FieldModes.of(points, given, tolerance=0.01)
    model = hhr.condense(heated(*modes.expansion(block.SOLID, EXPANSION), box=modes.joined(BOX)))
    modes.write_header(tmp_path / "modes.h")
    c_header.write_c_header(tmp_path / "press.h", model)
    (tmp_path / "press.c").write_text(
        """#include "modes.h"
#include "press.h"
int ask(double push, const double *field, double *outputs)
{
    double point[1 + T_MODES], forces[PRESS_CONDITIONS];
    point[0] = push;
    T_amplitudes(field, point + 1);
    press_work *work = press_new();
    int status = press_solve(work, point, forces, outputs);
    press_free(work);
    return status;
}
"""
    )
    words = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-shared", "-fPIC"]
    command = [compiler, *words, "-o", "press.so", "press.c", "-lm"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    library = ctypes.CDLL(str(tmp_path / "press.so"))
    values = np.ascontiguousarray(given[5])
    outputs = np.zeros(2)
    pointers = [ctypes.c_void_p(array.ctypes.data) for array in (values, outputs)]
    assert library.ask(ctypes.c_double(1e-3), *pointers) == 0
    expected = model.outputs({"push": 1e-3, **modes.amplitudes(values)})
    assert outputs == pytest.approx([expected["force"], expected["peak"]], rel=1e-9)


def test_points_in_another_unit_are_named():
    points = nodes()
    for scale in (1000.0, 0.001):
        load = hhr.ThermalExpansion(
            block.SOLID, EXPANSION, 1.0, hhr.NodalField(scale * points, points[:, 0])
        )
        with pytest.raises(SceneError, match="in the unit of the mesh"):
            full(heated(load))


@pytest.mark.parametrize(
    ("points", "values", "words"),
    [
        (np.zeros((3, 2)), np.zeros(4), "needs points"),
        (np.zeros(3), np.zeros(3), "needs points"),
        (np.zeros((3, 2)), np.array([0.0, np.nan, 1.0]), "finite"),
        (np.zeros((3, 2)), ["a", "b", "c"], "must be numbers"),
    ],
)
def test_wrong_values_are_named(points, values, words):
    with pytest.raises(SceneError, match=words):
        hhr.NodalField(points, values)


def test_wrong_fields_are_named():
    points = nodes()
    with pytest.raises(SceneError, match="not zero everywhere"):
        hhr.FieldModes.of(points, np.zeros((2, len(points))), tolerance=1.0)
    with pytest.raises(SceneError, match="must be positive"):
        hhr.FieldModes.of(points, fields_at(points), tolerance=0.0)
    modes = hhr.FieldModes.of(points, fields_at(points), tolerance=1.0)
    with pytest.raises(ParameterError, match="one for each point"):
        modes.amplitudes(np.zeros(3))
    with pytest.raises(ParameterError, match="must have finite values"):
        modes.amplitudes(np.full(len(points), np.nan))
    with pytest.raises(ParameterError, match="amplitude T1 of field T is missing"):
        modes.values({"push": 1.0})
    with pytest.raises(SceneError, match="a row for each field"):
        hhr.FieldModes.of(points, fields_at(points).T, tolerance=1.0)
    with pytest.raises(SceneError, match="must be one of parameters"):
        hhr.FieldModes.of(points, fields_at(points), tolerance=1.0, name="2T")
    with pytest.raises(SceneError, match="names T1, the amplitude of a mode"):
        modes.expansion(block.SOLID, "1e-5 * (1 + 1e-3 * T1)")
    assert len(repr(modes)) < 80 and len(repr(modes.expansion(block.SOLID, 1e-5)[0])) < 400


def test_the_zero_field_is_in_the_box():
    """Paths begin with it, though all given fields are warm."""
    points = nodes()
    modes = hhr.FieldModes.of(points, fields_at(points) + 500.0, tolerance=0.1)
    box = modes.joined()
    assert box.point(modes.amplitudes(np.zeros(len(points)))).tolist() == [0.0] * len(box.names)


def test_points_on_a_line_have_the_value_of_the_nearest():
    field = hhr.NodalField(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]), [1.0, 2.0, 3.0])
    assert field.at(np.array([[0.9, 0.3]])).tolist() == [2.0]
