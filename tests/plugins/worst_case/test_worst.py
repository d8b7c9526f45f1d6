"""The worst case of an output over a box: never exceeded, and found by others too."""

import itertools
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from scenes import lying, pressed_block, slope, space

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import (
    FileContentError,
    NotOfferedError,
    ParameterError,
    UndeterminedWarning,
)
from hhr_dolfinx.files import read_arrays, write_arrays
from hhr_dolfinx.plugins.worst_case import check, exact_check
from hhr_dolfinx.plugins.worst_case.affine import (
    AffineContact,
    Candidates,
    candidates_of,
    contact_of,
)
from hhr_dolfinx.plugins.worst_case.box_bound import Box, bounded
from hhr_dolfinx.plugins.worst_case.certificate import FORMAT, VERSION, parts_of

pytestmark = needs("worst_case", "tables")


def by_enumeration(schur, free):
    """Forces of s = free + S λ, complementary: the one set of closed conditions that holds."""
    m = len(free)
    best = None
    for statuses in itertools.product((False, True), repeat=m):
        closed = np.array(statuses)
        forces = np.zeros(m)
        forces[closed] = np.linalg.solve(schur[np.ix_(closed, closed)], -free[closed])
        slack = free + schur @ forces
        slack[closed] = 0.0
        lack = max(-forces.min(), -slack.min(), 0.0)
        if best is None or lack < best[0]:
            best = lack, forces, closed
    assert best[0] < 1e-12 * np.abs(free).max()
    return best[1:]


def random_contact(rng, m, count):
    """Conditions of which some open or close in the box."""
    root = rng.standard_normal((m, m + 2))
    schur = root @ root.T / m + 0.05 * np.eye(m)
    box = hhr.ParameterSpace(tuple(f"p{k}" for k in range(count)), (0.0,) * count, (1.0,) * count)
    slopes = rng.standard_normal((m, count))
    nothing = np.zeros((m, 0)), np.zeros((0, 1 + count))
    return AffineContact(schur, 0.5 * rng.standard_normal(m), slopes, box, *nothing)


@pytest.mark.parametrize("seed", range(12))
def test_no_point_of_a_box_exceeds_its_bounds(seed):
    """Small problems, solved by all sets of statuses: values, slopes and sure conditions, in boxes
    of all sizes; also if the forces at the corners are somewhat wrong.
    """
    rng = np.random.default_rng(seed)
    m, count = 5, int(rng.integers(1, 4))
    contact = random_contact(rng, m, count)
    weights = np.vstack([np.eye(m), -np.eye(m), rng.standard_normal((3, m))])
    K = len(weights)
    outputs = Candidates(rng.standard_normal(K), rng.standard_normal((K, count)), weights)
    nothing = np.zeros(m, dtype=bool)
    for size in (1.0, 0.3, 0.05):
        lower = (1 - size) * rng.random(count)
        box = Box(lower, lower + size, nothing, nothing.copy())
        exact = [by_enumeration(contact.schur, contact.free_slack(t))[0] for t in box.corners]
        forces_at = np.stack(exact, axis=1)
        wrong = forces_at + 0.05 * np.abs(forces_at).max() * rng.standard_normal(forces_at.shape)
        for start in (forces_at, wrong):
            found = bounded(contact, outputs, np.arange(K), box, start)
            for _ in range(40):
                t = lower + size * rng.random(count)
                forces, closed = by_enumeration(contact.schur, contact.free_slack(t))
                assert (outputs.values(t, forces) <= found.upper + 1e-9).all()
                assert closed[found.box.closed].all() and not closed[found.box.open].any()
            if start is wrong:
                continue
            for axis, step in enumerate(1e-6 * np.eye(count)):
                ahead, _ = by_enumeration(contact.schur, contact.free_slack(t + step))
                slope_ = (outputs.values(t + step, ahead) - outputs.values(t, forces)) / 1e-6
                assert (slope_ >= found.slopes[0][:, axis] - 1e-5).all()
                assert (slope_ <= found.slopes[1][:, axis] + 1e-5).all()


def with_motion(contact, t):
    """Forces and the one motion of bodies that contact alone holds, by all sets of statuses."""
    m = len(contact.free)
    best = None
    for statuses in itertools.product((False, True), repeat=m):
        closed = np.array(statuses)
        rows = np.append(np.flatnonzero(closed), m)
        if len(rows) == 1:
            continue
        solution = np.zeros(m + 1)
        right = contact.terms[rows] @ np.concatenate([[1.0], t])
        solution[rows] = -np.linalg.solve(contact.whole[np.ix_(rows, rows)], right)
        forces = solution[:m]
        slack = contact.free_slack(t) + contact.schur @ forces - contact.motions[:, 0] * solution[m]
        slack[closed] = 0.0
        lack = max(-forces.min(), -slack.min(), 0.0)
        if best is None or lack < best[0]:
            best = lack, solution, closed
    assert best[0] < 1e-9
    return best[1:]


@pytest.mark.parametrize("seed", range(8))
def test_no_point_exceeds_the_bounds_of_a_body_that_contact_holds(seed):
    """As above, with a motion whose balance the forces keep; small boxes have sure conditions that
    hold it, large ones do not.
    """
    rng = np.random.default_rng(100 + seed)
    m, count = 5, 2
    held = random_contact(rng, m, count)
    driving = np.concatenate([[1.0], 0.5 * rng.random(count)])[None]
    contact = replace(held, motions=1 - 0.5 * rng.random((m, 1)), driving=driving)
    weights = np.vstack([np.eye(m + 1), -np.eye(m + 1), rng.standard_normal((3, m + 1))])
    K = len(weights)
    outputs = Candidates(np.zeros(K), rng.standard_normal((K, count)), weights)
    nothing = np.zeros(m, dtype=bool)
    finite = 0
    for size in (1.0, 0.2, 0.02):
        lower = (1 - size) * rng.random(count)
        box = Box(lower, lower + size, nothing, nothing.copy())
        corners = np.stack([with_motion(contact, t)[0] for t in box.corners], axis=1)
        found = bounded(contact, outputs, np.arange(K), box, corners)
        finite += np.isfinite(found.upper).all()
        for _ in range(30):
            t = lower + size * rng.random(count)
            solution, closed = with_motion(contact, t)
            assert (outputs.values(t, solution) <= found.upper + 1e-9).all()
            assert closed[found.box.closed].all() and not closed[found.box.open].any()
    assert finite, "no box is small enough for its motion to be held"


def turned_by(bulge):
    """A block that lies on another one, pressed down and turned."""
    return lying(
        bulge=bulge,
        tilt=slope("q"),
        parameters=space(p=(1.0, 10.0), q=(0.0, 2.0)),
        outputs=(
            hhr.LargestPressure("peak", 0),
            hhr.DisplacementAt("moved", (0.5, 2.0), 1),
            hhr.ContactForce("left", 0, (0.0, 1.0)),
        ),
    )


@needs("floating")
@pytest.mark.filterwarnings("ignore:body 2 .* moves along axis 0")
def test_an_output_that_reads_an_undetermined_motion_is_refused():
    """A round block on one node may turn."""
    model = hhr.condense(turned_by(0.5))
    with (
        pytest.warns(UndeterminedWarning),
        pytest.raises(NotOfferedError, match="neither loads nor contact determine at p = "),
    ):
        hhr.worst(model, "moved")


@needs("floating")
@pytest.mark.filterwarnings("ignore:body 2 .* moves along axis 0")
@pytest.mark.parametrize("output", ["peak", "moved", "left"])
def test_a_block_that_contact_alone_holds(output, tmp_path):
    """What is proven holds at random points, and a certificate proves it again; the block turns
    with the second load.
    """
    model = hhr.condense(turned_by(0.05 if output == "peak" else 0.0))
    found = hhr.worst(model, output, 0.01)
    assert found.finished
    assert model.outputs(found.parameters)[output] == pytest.approx(found.value, rel=1e-8)
    values = [model.outputs(point)[output] for point in model.parameters.random(200, seed=3)]
    assert max(values) <= found.proven + 1e-9 * found.scale
    found.save(tmp_path / "proof.npz")
    assert "proven again" in hhr.check_certificate(tmp_path / "proof.npz")


def test_a_box_without_changes_of_status_is_bounded_exactly():
    rng = np.random.default_rng(3)
    contact = random_contact(rng, 5, 2)
    outputs = Candidates(np.zeros(5), np.zeros((5, 2)), np.eye(5))
    nothing = np.zeros(5, dtype=bool)
    box = Box(np.full(2, 0.4), np.full(2, 0.4001), nothing, nothing.copy())
    values = [by_enumeration(contact.schur, contact.free_slack(t))[0] for t in box.corners]
    found = bounded(contact, outputs, np.arange(5), box, np.stack(values, axis=1))
    assert (found.box.closed | found.box.open).all()
    assert found.upper == pytest.approx(np.max(values, axis=0), rel=1e-9, abs=1e-12)


def matrices(seed, m=8, count=3):
    """A condensed model of random matrices, with a peak, a force and a displacement."""
    rng = np.random.default_rng(seed)
    size = m + 4
    root = rng.standard_normal((size, size))
    names = tuple("abcdef"[:count])
    return hhr.condense_matrices(
        hhr.ParameterSpace(names, (-1.0,) * count, (2.0,) * count),
        root @ root.T + size * np.eye(size),
        rng.standard_normal((m, size)),
        rng.standard_normal((size, count)),
        np.column_stack([rng.random((m, 1)) * 0.05, np.zeros((m, count - 1))]),
        list(names),
        areas=0.5 + rng.random(m),
        displacement_outputs={"tip": rng.standard_normal(size)},
        force_outputs={"sum": np.ones(m)},
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("output", ["peak", "tip", "sum"])
def test_the_worst_case_is_near_one_found_and_above_all_others(seed, output):
    model = matrices(seed)
    found = hhr.worst(model, output, 0.01)
    assert found.finished and found.difference <= 0.01
    assert model.outputs(found.parameters)[output] == pytest.approx(found.value, rel=1e-9)
    values = [model.outputs(point)[output] for point in model.parameters.random(300, seed=seed)]
    assert max(values) <= found.proven * (1 + 1e-9)
    if output != "peak":
        least = hhr.worst(model, output, 0.01, smallest=True)
        assert least.proven <= min(values) + 1e-9 and least.value <= min(values)


@needs("studies")
@pytest.mark.parametrize("seed", range(3))
def test_the_peak_is_that_of_an_integer_program(seed):
    """Statuses as binary variables with big M, by HiGHS: another method, the same maximum."""
    from worst_case import by_integers

    model = matrices(seed, m=5, count=2)
    expected, _ = by_integers(model, "peak", seconds=300.0, gap=1e-7)
    found = hhr.worst(model, "peak", 1e-6)
    # HiGHS takes statuses as integers to 1e-6 of ten times the largest force
    assert found.value == pytest.approx(expected, rel=1e-5)
    assert found.proven >= expected * (1 - 1e-5)


def test_a_uniform_block_by_hand():
    """Its pressure is E / (1 - ν²) (push - gap) / 2, largest at the largest push."""
    scene = replace(pressed_block("plane_strain"), outputs=(hhr.LargestPressure("peak", 0),))
    found = hhr.worst(hhr.condense(scene), "peak", 1e-9)
    expected = 3.0 / (1 - 0.3**2) * (0.1 - 0.01) / 2
    assert found.value == pytest.approx(expected, rel=1e-9)
    assert found.proven == pytest.approx(expected, rel=1e-8)
    assert found.parameters == {"push": pytest.approx(0.1)}
    assert "nowhere in the box above" in str(found)
    assert found.never_beyond(expected * 1.001) and not found.never_beyond(expected * 0.999)


def test_a_limit_ends_the_search_as_soon_as_it_is_proven():
    model = matrices(0)
    whole = hhr.worst(model, "peak", 1e-4)
    early = hhr.worst(model, "peak", 1e-4, limit=2 * whole.value)
    assert early.proven <= 2 * whole.value and early.never_beyond(2 * whole.value)
    assert early.boxes < whole.boxes
    beyond = hhr.worst(model, "peak", 1e-4, limit=0.5 * whole.value)
    assert beyond.boxes < whole.boxes and beyond.proven >= whole.value
    assert not beyond.never_beyond(0.5 * whole.value) and beyond.value > 0.5 * whole.value


def test_what_is_left_when_time_is_over_is_proven_too():
    model = matrices(1, m=10, count=4)
    hasty = hhr.worst(model, "peak", 1e-6, seconds=1e-9)
    whole = hhr.worst(model, "peak", 1e-3)
    assert not hasty.finished and hasty.proven >= whole.value
    assert f"{hasty.difference:.2%}" in str(hasty)


def changed(path, target, **changes):
    """A certificate with other arrays and a right checksum."""
    header, arrays = read_arrays(path, FORMAT, VERSION)
    for name, change in changes.items():
        arrays[name] = change(arrays[name].copy())
    write_arrays(target, header, arrays)
    return target


def at(index, value):
    def change(array):
        array[index] = value
        return array

    return change


LIES = {
    "a lower value": {"proven": lambda value: value * 0.98},
    "a part that is missing": {
        name: (lambda array, name=name: array[:-1])
        for name in ("parents", "lower", "upper", "chosen")
    },
    "a part that is smaller": {"upper": lambda array: np.where(array > 0.4, array * 0.9, array)},
    "not the whole box": {"upper": at(0, 0.9)},
    "a candidate less": {"chosen": at((0, 0), False)},
    "no candidate in the parts": {"chosen": at(slice(1, None), False)},
    "other weights": {"weights": lambda array: 1.1 * array},
    "a softer problem": {"schur": lambda array: 0.9 * array},
    "an indefinite problem": {"schur": lambda array: array - 10 * np.eye(len(array)) * array.max()},
    "loads that are larger": {"slopes": lambda array: 1.2 * array},
    "a part of a later box": {"parents": at(1, 2)},
    "boxes outside": {"lower": at(1, -1.0)},
    "whole numbers, of which & is another one": {"chosen": lambda array: 2 * array.astype(int)},
    "no candidates": {
        name: (lambda array, axis=axis: array.take([], axis))
        for name, axis in (("constant", 0), ("along", 0), ("weights", 0), ("chosen", 1))
    },
    "two values": {"proven": lambda value: np.array([value, value])},
    "forces whose products are no numbers": {
        "solutions": lambda array: np.where(array > 0, 1.7e308, -1.7e308),
        "proven": lambda value: value - 100.0,
    },
    "weights whose squares are no numbers": {"weights": lambda array: 1e300 * array},
    "weights whose squares are zero": {
        "weights": lambda array: 1e-200 * array,
        "solutions": lambda array: 0.0 * array,
        "proven": lambda value: 0.0 * value,
    },
}


@pytest.mark.parametrize("lie", LIES)
def test_certificates_that_do_not_prove_are_found(lie, tmp_path):
    """Each with a right checksum, so that the proof itself is what fails."""
    found = hhr.worst(matrices(0), "peak", 0.02)
    assert found.boxes > 4
    found.save(tmp_path / "proof.npz")
    claim = hhr.check_certificate(tmp_path / "proof.npz")
    assert claim.startswith(f"peak is nowhere in the box above {found.proven!r}")
    with pytest.raises(FileContentError, match="no proof"):
        hhr.check_certificate(changed(tmp_path / "proof.npz", tmp_path / "lie.npz", **LIES[lie]))


@pytest.mark.parametrize("output", ["peak", "sum"])
def test_a_certificate_is_proven_in_rational_numbers(output, tmp_path):
    """Without a rounding, of the value that the file says and a billionth of it."""
    found = hhr.worst(matrices(0), output, 0.02)
    found.save(tmp_path / "proof.npz")
    claim = hhr.check_certificate(tmp_path / "proof.npz", exact=True)
    said = float(claim.split(" above ")[1].split(":")[0])
    assert found.proven < said <= found.proven * (1 + 2e-9)
    assert "rational numbers" in claim


@pytest.mark.parametrize("lie", [*LIES, "a value lower by a part of a million"])
def test_lies_are_found_in_rational_numbers_too(lie, tmp_path):
    found = hhr.worst(matrices(0), "peak", 0.02)
    found.save(tmp_path / "proof.npz")
    changes = LIES.get(lie, {"proven": lambda value: value * (1 - 1e-6)})
    with pytest.raises(FileContentError, match="no proof"):
        hhr.check_certificate(
            changed(tmp_path / "proof.npz", tmp_path / "lie.npz", **changes), exact=True
        )


def test_exact_bounds_of_a_box_are_those_of_doubles(tmp_path):
    """Both checkers bound the same box: to round-off, and roots from above."""
    hhr.worst(matrices(1), "peak", 0.02).save(tmp_path / "proof.npz")
    _, arrays = read_arrays(tmp_path / "proof.npz", FORMAT, VERSION)
    (part, *_), nothing = parts_of(arrays), np.zeros(len(arrays["free"]), dtype=bool)
    exact = exact_check._ExactRest(exact_check._Rational.of(arrays), part, nothing, nothing)
    names = "schur", "free", "slopes", "motions", "driving", "corners", "solutions"
    problem = check._Problem(*(arrays[name] for name in names))
    double = check._Rest(problem, part, nothing, nothing)
    outputs = arrays["constant"], arrays["along"], problem.scaled(arrays["weights"])
    upper, (low, high) = double.bounds(*outputs)
    assert float(exact.far) == pytest.approx(double.far, rel=1e-9)
    np.testing.assert_allclose(exact.upper().astype(float), upper, rtol=1e-9)
    signs = exact.slopes()
    np.testing.assert_array_equal(signs[0], np.sign(low))
    np.testing.assert_array_equal(signs[1], np.sign(high))


@pytest.mark.parametrize("value", ["0", "1/3", "4", "1e-300", "123456789e250"])
def test_roots_are_enclosed_from_above(value):
    value = Fraction(value)
    root = exact_check.root_above(value)
    assert root**2 >= value and root**2 <= value * (1 + Fraction(1, 2**100))


def test_motions_and_many_conditions_are_not_proven_in_rational_numbers(tmp_path):
    with pytest.raises(NotOfferedError, match="displacements hold"):
        hhr.check_certificate(between_walls(tmp_path), exact=True)


def between_walls(tmp_path, **changes):
    """A certificate of a body between two walls, pressed to the first by 10: its force is 10."""
    arrays = {
        "schur": np.eye(2),
        "free": np.zeros(2),
        "slopes": np.zeros((2, 1)),
        "motions": np.array([[1.0], [-1.0]]),
        "driving": np.array([[10.0, 0.0]]),
        "constant": np.zeros(1),
        "along": np.zeros((1, 1)),
        "weights": np.array([[1.0, 0.0, 0.0]]),
        "proven": np.array(10.0),
        "parents": np.array([-1]),
        "lower": np.zeros((1, 1)),
        "upper": np.ones((1, 1)),
        "chosen": np.ones((1, 1), dtype=bool),
        "corners": np.array([[0.0], [1.0]]),
        "solutions": np.array([[10.0, 0.0, 10.0]] * 2),
    }
    header = {"format": FORMAT, "version": VERSION, "output": "force", "smallest": False}
    write_arrays(tmp_path / "walls.npz", header, arrays | changes)
    return tmp_path / "walls.npz"


def test_forces_that_pull_balance_nothing(tmp_path):
    """A pull at the second wall would balance the load without a force at the first one; so would
    no force, if loads along a motion were measured by forces that do not act on it.
    """
    assert "above 10.0" in hhr.check_certificate(between_walls(tmp_path))
    lie = {"proven": np.array(0.5), "solutions": np.array([[0.0, -10.0, 0.0]] * 2)}
    with pytest.raises(FileContentError, match="do not balance"):
        hhr.check_certificate(between_walls(tmp_path, **lie))
    small = {"motions": np.array([[1e-12], [-1e-12]]), "driving": np.array([[1e-11, 0.0]])}
    lie["solutions"] = np.zeros((2, 3))
    with pytest.raises(FileContentError, match="do not balance"):
        hhr.check_certificate(between_walls(tmp_path, **(lie | small)))


def test_a_box_with_too_many_corners_is_no_proof(tmp_path):
    """It ended only when memory was full."""
    count = 40
    sizes = {
        "slopes": np.zeros((2, count)),
        "driving": np.zeros((1, 1 + count)),
        "along": np.zeros((1, count)),
        "lower": np.zeros((1, count)),
        "upper": np.ones((1, count)),
        "corners": np.zeros((2, count)),
    }
    with pytest.raises(FileContentError, match="more than 12 sides"):
        hhr.check_certificate(between_walls(tmp_path, **sizes))
    held = {"motions": np.zeros((2, 0)), "driving": np.zeros((0, 1 + count))}
    held |= {"weights": np.ones((1, 2)), "solutions": np.zeros((2, 2))}
    with pytest.raises(FileContentError, match="more than 12 sides"):
        hhr.check_certificate(between_walls(tmp_path, **(sizes | held)), exact=True)


def simple(compliance, gaps, outputs=None):
    """S, and gaps by their constants and slopes, (m, 1 + P)."""
    m, columns = gaps.shape
    names = tuple("abcdefghijklmnop"[: columns - 1])
    box = hhr.ParameterSpace(names, (0.0,) * len(names), (1.0,) * len(names))
    return hhr.condense_matrices(
        box,
        np.linalg.inv(compliance),
        np.eye(m),
        np.zeros(gaps.shape),
        gaps,
        ["1", *names],
        areas=np.ones(m),
        displacement_outputs={} if outputs is None else outputs,
    )


@pytest.mark.parametrize("compliance", [0.3, 2.31497503, 0.7, 1.9, 5.3, 11.7])
def test_slopes_that_end_at_zero_are_proven_again(compliance, tmp_path):
    """A single condition that closes in the box: its force rises by zero or more, but for
    round-off, which differs between the search and the checker.
    """
    found = hhr.worst(simple(np.array([[compliance]]), np.array([[0.5, -1.0]])), "peak")
    assert found.proven == pytest.approx(0.5 / compliance)
    model = simple(np.array([[compliance]]), np.array([[0.5, -1.0]]), {"moved": [1.0]})
    highest = hhr.worst(model, "moved")
    assert highest.proven == 0.0
    for proof in (found, highest):
        proof.save(tmp_path / "proof.npz")
        assert "proven again" in hhr.check_certificate(tmp_path / "proof.npz")
        assert "rational" in hhr.check_certificate(tmp_path / "proof.npz", exact=True)


def test_units_of_conditions_may_differ(tmp_path):
    """A diagonal of S from 1e-18 to 1, not near a singular one but for its units."""
    units = np.array([1.0, 1e-9, 1.0])
    rng = np.random.default_rng(0)
    gaps = units[:, None] * rng.standard_normal((3, 3))
    coupled = np.outer(units, units) * (np.eye(3) + 0.3)
    found = hhr.worst(simple(coupled, gaps), "peak")
    found.save(tmp_path / "proof.npz")
    assert "proven again" in hhr.check_certificate(tmp_path / "proof.npz")


def test_an_s_that_is_definite_by_round_off_alone_proves_nothing(tmp_path):
    """Its inverse is any matrix."""
    near = np.array([[1.0, 1.0 - 1e-15], [1.0 - 1e-15, 1.0]])
    with pytest.raises(FileContentError, match="round-off"):
        hhr.check_certificate(between_walls(tmp_path, schur=near))


def test_a_parameter_with_no_effect_but_round_off_is_not_divided_for_ever():
    """Corners of the cube differ in status only if two parameters differ: |b + c - 1| is the
    largest pressure.
    """
    found = hhr.worst(
        simple(np.eye(2), np.array([[-1, 1e-17, 1, 1], [1, 2e-17, -1, -1.0]])), "peak"
    )
    assert found.finished and found.boxes < 100
    assert found.value == pytest.approx(1.0)


def test_weights_of_forces_are_exact_beside_a_large_constant():
    """A force of one moves a stiff body by less than the digits of how loads move it."""
    rng = np.random.default_rng(0)
    size, m = 6, 3
    root = rng.standard_normal((size, size))
    stiffness = 1e13 * (root @ root.T + size * np.eye(size))
    rows, tip = rng.standard_normal((m, size)), rng.standard_normal(size)
    model = hhr.condense_matrices(
        hhr.ParameterSpace(("a",), (1.0,), (2.0,)),
        stiffness,
        rows,
        1e13 * rng.standard_normal((size, 1)),
        np.zeros((m, 1)),
        ["a"],
        displacement_outputs={"tip": tip},
    )
    found = candidates_of(model, "tip", contact_of(model)).weights[0]
    expected = -np.linalg.solve(stiffness, rows.T).T @ tip
    assert found == pytest.approx(expected, rel=1e-11)


def test_forces_of_a_certificate_need_not_be_right(tmp_path):
    """Round-off is forgiven; larger errors enlarge the bounds, until they prove no more."""
    found = hhr.worst(matrices(2), "sum", 0.05)
    found.save(tmp_path / "proof.npz")
    noise = np.random.default_rng(0)

    def wrong(size):
        return lambda array: array + size * array.max() * noise.standard_normal(array.shape)

    near = changed(tmp_path / "proof.npz", tmp_path / "near.npz", solutions=wrong(1e-14))
    assert repr(found.proven) in hhr.check_certificate(near)
    far = changed(tmp_path / "proof.npz", tmp_path / "far.npz", solutions=wrong(0.1))
    with pytest.raises(FileContentError, match="leaves candidate"):
        hhr.check_certificate(far)


def test_a_damaged_certificate_is_named(tmp_path):
    hhr.worst(matrices(0), "sum", 0.05).save(tmp_path / "proof.npz")
    content = (tmp_path / "proof.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(content[: len(content) // 2])
    with pytest.raises(FileContentError):
        hhr.check_certificate(tmp_path / "cut.npz")


def test_what_cannot_be_proven_is_refused_with_the_reason():
    model = matrices(0)
    with pytest.raises(ParameterError, match="there is no output 'peek'"):
        hhr.worst(model, "peek")
    for wrong in (0.0, -0.1, float("nan")):
        with pytest.raises(ParameterError, match="within"):
            hhr.worst(model, "peak", wrong)
    with pytest.raises(ParameterError, match="limit = nan"):
        hhr.worst(model, "peak", limit=float("nan"))
    with pytest.raises(NotOfferedError, match="not for this str"):
        hhr.worst("model.npz", "peak")
    many = simple(np.eye(1), np.ones((1, 14)))
    with pytest.raises(NotOfferedError, match="12 parameters at most, not for 13"):
        hhr.worst(many, "peak")
    with pytest.raises(ParameterError, match="largest of"):
        hhr.worst(model, "peak", smallest=True)
    scene = replace(
        pressed_block("plane_strain"),
        outputs=(hhr.ContactWidth("width", 0), hhr.LargestPressure("peak", 0)),
    )
    with pytest.raises(NotOfferedError, match="no largest of affine functions"):
        hhr.worst(hhr.condense(scene), "width")
    with pytest.raises(NotOfferedError, match="condensed models of one stiffness"):
        hhr.worst(hhr.FullOrderModel(scene, MPI.COMM_SELF), "peak")


@needs("friction")
def test_friction_is_refused_since_its_answers_depend_on_the_path():
    scene = pressed_block("plane_strain")
    floor = replace(scene.contacts[0], friction=0.3)
    scene = replace(scene, contacts=(floor,), outputs=(hhr.LargestPressure("peak", 0),))
    with pytest.raises(NotOfferedError, match="memory"):
        hhr.worst(hhr.condense(scene), "peak")


@needs("moduli")
def test_a_stiffness_that_is_a_parameter_is_refused():
    scene = pressed_block("plane_strain")
    body = replace(scene.bodies[0], young="E")
    box = space(push=(0.0, 0.1), E=(2.0, 4.0))
    scene = replace(
        scene, bodies=(body,), parameters=box, outputs=(hhr.LargestPressure("peak", 0),)
    )
    with pytest.raises(NotOfferedError, match="one stiffness"):
        hhr.worst(hhr.condense(scene), "peak")


def test_commands_prove_and_prove_again(tmp_path):
    from click.testing import CliRunner

    from hhr_dolfinx.command.main import hhr as cli

    model = matrices(0)
    hhr.save_model(tmp_path / "model.npz", model)
    expected = hhr.worst(model, "sum", 0.05, smallest=True)
    run = CliRunner().invoke
    proof = str(tmp_path / "proof.npz")
    given = ["worst", str(tmp_path / "model.npz"), "sum", "--within", "0.05", "--smallest"]
    said = run(cli, [*given, "--certificate", proof])
    assert said.exit_code == 0, said.output
    assert f"nowhere in the box below {expected.proven:.6g}" in said.output
    limited = run(cli, [*given, "--limit", "-1e9"])
    assert "never beyond -1e+09: proven" in limited.output
    again = run(cli, ["certificate", proof])
    assert again.exit_code == 0 and repr(expected.proven) in again.output
    other = run(cli, ["worst", str(tmp_path / "model.npz"), "summ"])
    assert other.exit_code != 0 and "there is no output 'summ'" in other.output
