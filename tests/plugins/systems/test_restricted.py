"""User-defined systems beside constraints and springs: K of all dofs is restricted, and springs are
added to it.
"""

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from mpirun import launch
from my_system import MySystem
from needs import needs
from processes import folders_of
from scenes import block_scene, largest_difference, lying, pressed_pair, slope_errors, space
from scipy.sparse import csr_matrix, save_npz
from toy_system import Foundation, Parted

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ClaimError, NotOfferedError, NotSolvableError, SceneError
from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.full_order.system import System
from hhr_dolfinx.geometries import block
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side
from hhr_dolfinx.models.estimates import ESTIMATE_NUMBERS, Estimate

pytestmark = needs("constraints", "nodal_loads")

SWITCHES = (
    "bedding",
    "bolt_force",
    "directed",
    "equation",
    "mean_motion",
    "periodic",
    "preload",
    "rigid_motion",
    pytest.param("serendipity", marks=needs("second_order")),
    "springs",
    "tie",
)
TEMPLATE = str(Path(__file__).parents[3] / "extension_templates" / "system")
STIFF = "stiff"
"""Parameter that multiplies K of all bodies."""


class Stiffened(System):
    """K of the bodies times a parameter, written out with its loads and derivatives."""

    def __init__(self, *given):
        super().__init__(*given)
        self.axis = self.problem.parameters.names.index(STIFF)
        own = self.problem.free[self.problem.rows]
        self.pulled = (
            csr_matrix(self.problem.own_stiffness @ self.problem.lifts)
            .multiply(own[:, None])
            .tocsc()
        )

    def equations(self, point, theta):
        problem = self.problem
        matrix = problem.own_stiffness.copy()
        matrix.data *= point[self.axis]
        loads = problem.external[problem.rows] @ theta - point[self.axis] * (self.pulled @ theta)
        return problem, self.made(matrix, problem), loads

    def explicit(self, point, forces, unknown):
        problem = self.problem
        acting, slopes = problem.amplitudes.slopes_at(point)
        left = -(problem.external[problem.rows][:, acting] @ slopes)
        left += point[self.axis] * (self.pulled[:, acting] @ slopes)
        left[:, self.axis] += problem.own_stiffness @ unknown + self.pulled @ problem.amplitudes(
            point
        )
        return left, problem.gaps[:, acting] @ slopes


class StiffenedParts(Stiffened):
    """The same with its part."""

    def parts(self):
        return (Modulus(STIFF, "1", self.problem.parameters.names),), (self.problem.own_stiffness,)


def drafted(switch, system=None):
    """Scene of two blocks with a capability, whose stiffness is a parameter: by their moduli, or by
    a system.
    """
    from hhr_dolfinx.plugins.conformance.draft import ChosenSwitch, composed, switches

    draft = composed([ChosenSwitch(switch, switches()[switch])]).with_parameter(
        STIFF, 0.5, 2.0, 1.5
    )
    if system is not None:
        return dataclasses.replace(draft, system=system)
    stiffer = [dataclasses.replace(body, young=f"{body.young} * {STIFF}") for body in draft.bodies]
    return dataclasses.replace(draft, bodies=tuple(stiffer))


@needs("conformance")
@pytest.mark.filterwarnings("ignore:displacements are of second order and the sides")
@pytest.mark.parametrize("switch", SWITCHES)
def test_it_is_the_scene_without_it_whose_stiffness_is_the_same(switch):
    """Answers and outputs to 1e-10, gradients to 1e-8: K is assembled in another order and solved
    for anew.
    """
    draft = drafted(switch)
    exact = draft.model(draft.scene())
    full = hhr.FullOrderModel(drafted(switch, StiffenedParts).scene(), MPI.COMM_SELF)
    touched = set()
    for _, point in draft.path(share=0.3)[1:4]:
        one, other = (model.solve(point, gradient=True) for model in (full, exact))
        assert largest_difference(one.displacement(), other.displacement()) <= 1e-10
        assert largest_difference(one.forces(), other.forces()) <= 1e-10
        values = [list(answer.outputs().values.values()) for answer in (one, other)]
        assert np.allclose(*values, rtol=1e-10, atol=1e-12)
        slopes = [answer.gradient.multipliers for answer in (one, other)]
        assert largest_difference(*slopes) <= 1e-8
        touched.add(int(one.active.sum()))
    assert min(touched) < full.conditions and max(touched) > 0, "contact never opens or closes"
    # what reductors read
    pair = [model.problem.at(point) for model in (full, exact)]
    assert abs(pair[0].stiffness - pair[1].stiffness).max() <= 1e-12 * abs(pair[1].stiffness).max()
    if exact.scene.constraints:  # without them lifts of whole bodies are rigid motions
        for name in ("loads", "pulled"):
            one, other = (getattr(problem, name) for problem in pair)
            assert abs(one - other).max() <= 1e-12 * abs(other).max(), name


def places():
    """Nodes at one height of both flanks of the upper block, and of the lower one."""
    return (hhr.Nodes.near((x, y)) for x, y in ((1.0, 1.5), (2.0, 1.5), (1.0, 0.5)))


def joined(system, **changes):
    """The pair with an equation that has a value, springs at a dof of it and at a free one, and a
    foundation.
    """
    left, right, low = places()
    equation = hhr.Equation(((left, 0, 1.0), (right, 0, -2.0)), "0.1 * slide + 0.0002 * k")
    springs = hhr.Springs(left, 0, 3.0, "0.001 * k"), hhr.Springs(low, 0, 2.0)
    pressed = hhr.Pressure(side(SECOND, 0, True), hhr.Amplitude(slopes={"load": 1.0}))
    given = {"constraints": (equation,), "loads": (pressed, *springs), "system": system} | changes
    return pressed_pair(
        "plane_strain", ((3.0, 0.3), (4.0, 0.3)), {"k": (0.0, 20.0)}, cells=4, **given
    )


@pytest.fixture(scope="module")
def full():
    return hhr.FullOrderModel(joined(Foundation))


@pytest.fixture(scope="module")
def bare():
    """The pair without constraint, springs and system, whose arrays the reference uses."""
    with pytest.warns(hhr.errors.SceneWarning, match="k"):
        return hhr.FullOrderModel(joined(None, constraints=(), loads=joined(None).loads[:1]))


def saddle(bare, point, active):
    """Displacement and forces of one dense matrix, in which the equation has a multiplier of its
    own.
    """
    problem = bare.problem
    theta, k = problem.amplitudes(point), point[problem.parameters.names.index("k")]
    slide = point[problem.parameters.names.index("slide")]
    free = np.flatnonzero(problem.free)
    stiffness = problem.stiffness.toarray() + k * problem.mass.toarray()
    number = [
        2 * int(np.abs(problem.points - place).sum(axis=1).argmin())
        for place in ((1, 1.5), (2, 1.5), (1, 0.5))
    ]
    pushed = np.zeros(problem.free.size)
    for dof, modulus, ground in ((number[0], 3.0, 0.001 * k), (number[2], 2.0, 0.0)):
        stiffness[dof, dof] += modulus
        pushed[dof] += modulus * ground
    lifted = problem.lifts @ theta
    loads = problem.external @ theta + pushed - stiffness @ lifted
    equation = np.zeros(problem.free.size)
    equation[number[:2]] = 1.0, -2.0
    rows = np.vstack([equation, problem.contact[active].toarray()])[:, free]
    value = 0.1 * slide + 0.0002 * k - equation @ lifted
    whole = np.block([[stiffness[np.ix_(free, free)], rows.T], [rows, np.zeros((len(rows),) * 2)]])
    solved = np.linalg.solve(
        whole, np.concatenate([loads[free], [value], (problem.gaps @ theta)[active]])
    )
    unknown = np.zeros(problem.free.size)
    unknown[free] = solved[: free.size]
    forces = np.zeros(len(problem.gaps))
    forces[active] = solved[free.size + 1 :]
    return lifted + unknown, forces, problem.gaps @ theta - problem.contact @ unknown


def test_answers_are_those_of_a_multiplier_for_the_equation(full, bare):
    """No dof is eliminated in the reference; its forces press and its gaps do not overlap."""
    for point in full.parameters.random(5, 3):
        answer = full.solve(point)
        displacement, forces, slack = saddle(bare, point, np.flatnonzero(answer.active))
        assert largest_difference(answer.displacement(), displacement) <= 1e-9
        assert largest_difference(answer.forces(), forces) <= 1e-9
        assert forces.min() > -1e-10 and slack.min() > -1e-10


@pytest.mark.parametrize("system", [Foundation, Parted, MySystem("k")])
def test_gradients_are_differences(system):
    """Along all parameters, that of the foundation and of values and grounds among them."""
    full = hhr.FullOrderModel(joined(system))
    assert np.max(slope_errors(full, [0.04, 0.01, 0.03, 0.0, 6.0])) <= 1e-6


@pytest.mark.parametrize("system", [Foundation, Parted, MySystem("k")])
def test_moduli_of_bodies_may_be_parameters(system):
    """Answers are those of bodies whose moduli are numbers, and derivatives are differences."""
    point = {"push": 0.04, "slide": 0.01, "load": 0.03, "gap": 0.0, "k": 6.0}
    box = {"k": (0.0, 20.0), "stiff": (2.0, 6.0), "nu": (0.1, 0.4)}
    joint = joined(system)
    changed = {"constraints": joint.constraints, "loads": joint.loads, "system": system}
    varied = hhr.FullOrderModel(
        pressed_pair("plane_strain", (("stiff", "nu"), (4.0, 0.3)), box, cells=4, **changed)
    )
    for stiff, nu in ((2.1, 0.38), (5.5, 0.12)):
        numbers = pressed_pair(
            "plane_strain", ((stiff, nu), (4.0, 0.3)), {"k": (0.0, 20.0)}, cells=4, **changed
        )
        exact = hhr.FullOrderModel(numbers).solve(point)
        found = varied.solve(point | {"stiff": stiff, "nu": nu})
        assert largest_difference(found.displacement(), exact.displacement()) <= 1e-9
        assert largest_difference(found.forces(), exact.forces()) <= 1e-9
    assert np.max(slope_errors(varied, [0.04, 0.01, 0.03, 0.0, 6.0, 5.5, 0.12])) <= 1e-6


@pytest.mark.parametrize("system", [Parted, MySystem("k")])
@needs("moduli")
def test_small_models_and_their_bounds(system):
    """Condensed and hyper-reduced; errors of answers that nothing was trained on are within what is
    said.
    """
    trained = hhr.train(joined(system), hhr.Sobol(40), held_out=4, comm=MPI.COMM_SELF)
    full = trained.full_order
    models = (
        trained.condense(),
        trained.build(hhr.Recipe(hhr.Pod(1e-10), domain=hhr.Rid(20, 20)).as_it_is()),
    )
    for model, off in zip(models, (1e-5, 1e-3), strict=True):
        for point in full.parameters.random(6, 1):
            answer, exact = model.solve(point, outside="ignore"), full.solve(point)
            assert largest_difference(answer.forces(), exact.forces()) <= off
            assert largest_difference(answer.displacement(), exact.displacement()) <= off
            left, right = (
                2 * np.abs(full.problem.points - (x, 1.5)).sum(axis=1).argmin() for x in (1, 2)
            )
            value = 0.1 * point[1] + 0.0002 * point[4]
            u = answer.displacement()
            assert abs(u[left] - 2 * u[right] - value) <= 1e-10
            said = answer.estimate()
            if said is not None and said.kind == "bound":
                assert np.linalg.norm(answer.forces() - exact.forces()) <= said.forces_euclid + 1e-9


@pytest.mark.filterwarnings("ignore")
def test_without_parts_reductors_refuse_it(full):
    with pytest.raises(
        NotOfferedError, match="is not offered for a user-defined system without parts"
    ):
        hhr.condense(full)


def test_a_constant_k_is_restricted_once():
    """Factors of one matrix are kept: another point has the same K."""

    class Constant(System):
        def __init__(self, *given):
            super().__init__(*given)
            self.whole = self.made(self.problem.own_stiffness.copy(), self.problem)

        def equations(self, point, theta):
            return self.problem, self.whole, self.problem.loads[self.problem.rows] @ theta

    full = hhr.FullOrderModel(joined(Constant))
    ends = [full.system.at(point).stiffness for point in full.parameters.random(2, 0)]
    assert ends[0] is ends[1]
    point = full.parameters.middle
    elastic = hhr.FullOrderModel(joined(None))
    assert largest_difference(full.solve(point).forces(), elastic.solve(point).forces()) <= 1e-10


class Late(Parted):
    """A foundation that is stiffer than its part above a corner of the box alone."""

    def equations(self, point, theta):
        problem, stiffness, loads = super().equations(point, theta)
        matrix = stiffness.matrix.copy()
        matrix.data += max(point[self.axis] - 19.9, 0.0) * self.mass.data
        return problem, self.made(matrix, problem), loads


class OnDependent(Parted):
    """A term that no part states, in rows of a dof that the equation eliminates."""

    def equations(self, point, theta):
        problem, stiffness, loads = super().equations(point, theta)
        matrix = stiffness.matrix.copy()
        dof = 2 * int(np.abs(problem.points - (1, 1.5)).sum(axis=1).argmin())
        matrix[dof, dof] += 1e-6
        return problem, self.made(matrix, problem), loads


class Soft(Parted):
    """Understates a bedding by a part of 1e-10 of K, which nothing else holds upright."""

    def equations(self, point, theta):
        problem, stiffness, loads = super().equations(point, theta)
        matrix = stiffness.matrix.copy()
        matrix.data += 1e-10 * abs(matrix).max() * (self.mass.data / self.mass.max())
        return problem, self.made(matrix, problem), loads


class Drawn(Parted):
    """Loads without what imposed displacements draw by the foundation."""

    def equations(self, point, theta):
        problem, stiffness, _ = super().equations(point, theta)
        return problem, stiffness, problem.loads[problem.rows] @ theta


LIES = {Late: "K of", OnDependent: "K of", Soft: "K of", Drawn: "the loads of"}


@pytest.mark.parametrize("system", LIES)
def test_parts_are_compared_before_dofs_are_eliminated(system):
    """At the corners of the box too, and each entry with its own diagonal: the norm of K hid a
    bedding.
    """
    with pytest.raises(
        SceneError, match=f"states parts, and {LIES[system]} its equations differ from their sum by"
    ):
        hhr.FullOrderModel(joined(system))


class Slanted(Foundation):
    """K with an entry that has no mirror image."""

    def equations(self, point, theta):
        problem, stiffness, loads = super().equations(point, theta)
        matrix = stiffness.matrix.copy()
        matrix.data[1] += 1e-3
        return problem, self.made(matrix, problem), loads


class Scaled(Foundation):
    bodies = ()


class Long(Foundation):
    def equations(self, point, theta):
        problem, stiffness, loads = super().equations(point, theta)
        return problem, stiffness, np.append(loads, 0.0)


class Bare(Foundation):
    def equations(self, point, theta):
        problem, stiffness, loads = super().equations(point, theta)
        return problem, stiffness.matrix, loads


REFUSED = {
    Slanted: "is not symmetric at",
    Scaled: "scales K of each body, and constraints and springs act on K of all",
    Long: "loads of the system of scene 'pair_plane_strain' have the shape",
    Bare: "make it by made",
}


@pytest.mark.parametrize("system", REFUSED)
def test_what_it_cannot_be(system):
    with pytest.raises(SceneError, match=REFUSED[system]):
        hhr.FullOrderModel(joined(system))


@pytest.mark.parametrize(
    "what", [pytest.param(name, marks=needs(name)) for name in ("inelastic", "shapes")]
)
def test_what_states_k_too_is_refused(what):
    """A law of a body, and a mesh that moves; each with its reason."""
    first, second = joined(Parted).bodies
    if what == "inelastic":
        changes = {"bodies": (first, dataclasses.replace(second, law=hhr.Plasticity(0.1)))}
    else:
        changes = {"shapes": (hhr.Shape(FIRST, ("x", "y * (1 + 0.001 * k)")),)}
    named = {"inelastic": "laws of bodies", "shapes": "shapes"}[what]
    with pytest.raises(
        SceneError, match=f"has {named} and a user-defined system: .*Leave one of them out"
    ):
        dataclasses.replace(joined(Parted), **changes)


class Vanishing(Parted):
    """A foundation whose stiffness is zero in the middle of the box."""

    def _weight(self, point):
        return (point[self.axis] - 10.0) ** 2

    def equations(self, point, theta):
        moved = np.array(point)
        moved[self.axis] = self._weight(point)
        return super().equations(moved, theta)

    def parts(self):
        names = self.problem.parameters.names
        return (Modulus("1", "1", names), Modulus("(k - 10)**2", "1", names)), super().parts()[1]


@needs("floating")
def test_a_kernel_of_the_middle_alone_is_refused():
    """Motions of the body were unknowns of all answers, as if the foundation never resisted them:
    6.06 for 4.99.

    Beside supports the same system is solved and reduced, with a weight that vanishes in the
    middle.
    """
    box = space(p=(1.0, 10.0), k=(0.0, 20.0))
    with pytest.raises(
        NotSolvableError,
        match=r"can move freely in the middle of the box: .* the system of the scene",
    ):
        hhr.FullOrderModel(lying(cells=(4, 2), parameters=box, system=Vanishing))
    full = hhr.FullOrderModel(lying(cells=(4, 2), parameters=box, system=Parted))
    with pytest.raises(NotSolvableError, match="singular at this parameter"):
        full.solve([5.0, 0.0])
    assert full.solve([5.0, 1.0]).forces().sum() > 0


class Upright(Parted):
    """A foundation along the last axis alone: nothing resists motions sideways, which no load
    drives.
    """

    def __init__(self, *given):
        super().__init__(*given)
        self.mass.data[self.mass.indices % 2 != 1] = 0.0


@needs("floating", "moduli", "exact_errors")
@pytest.mark.filterwarnings("ignore")
def test_a_kernel_that_the_system_leaves_has_no_bound_and_says_so():
    """It was said to be held by contact alone, and the foundation holds it.

    Answers agree with full ones.
    """
    box = space(p=(1.0, 10.0), k=(1.0, 20.0))
    training = hhr.train(
        lying(cells=(4, 2), parameters=box, system=Upright), hhr.Sobol(24), held_out=4
    )
    full = training.full_order
    assert full.problem.kernel.idle.shape[1] == 1 and not full.problem.held_by_contact
    for model in (training.build(), training.condense()):
        assert model.known_error.startswith("none: nothing resists some motions of bodies, and K")
        for point in full.parameters.random(6, 5):
            answer = model.solve(point, outside="ignore")
            assert answer.estimate() is None
            assert largest_difference(answer.forces(), full.solve(point).forces()) <= 1e-4


@needs("moduli")
def test_a_weight_that_vanishes_in_the_middle_is_reduced():
    trained = hhr.train(joined(Vanishing), hhr.Sobol(32), held_out=4, comm=MPI.COMM_SELF)
    full = trained.full_order
    model = trained.build(hhr.Recipe(hhr.Pod(1e-10), domain=hhr.Rid(20, 20)).as_it_is())
    points = full.parameters.random(6, 1)
    found, exact = (
        [one.solve(point, outside="ignore").forces() for point in points] for one in (model, full)
    )
    assert largest_difference(found, exact) <= 1e-3


def returning(model):
    """A way to reduce that returns a model whatever it is given."""
    return SimpleNamespace(reduced=lambda *given: model)


@needs("moduli")
def test_a_bound_is_compared_without_parts():
    """Its energy is that of K at the point, which no part states."""
    system = hhr.train(joined(Parted), hhr.Sobol(24), held_out=3, comm=MPI.COMM_SELF)
    full = hhr.FullOrderModel(joined(Foundation))
    sets = [hhr.compute_snapshots(full, full.parameters.random(8, seed)) for seed in (0, 1)]
    model = system.build(hhr.Recipe(hhr.Pod(1e-4), domain=hhr.Rid(20, 20)).as_it_is())
    said = Estimate("bound", **(dict.fromkeys(ESTIMATE_NUMBERS, 1e3) | {"primal": 1e-9}))
    fields = type(
        "Said", (type(model.fields),), {"exact": False, "estimate": lambda self, answer: said}
    )
    own = {one.name: getattr(model.fields, one.name) for one in dataclasses.fields(model.fields)}
    with pytest.raises(
        ClaimError, match="a bound of 1e-09 of the displacement in energy, and the error is"
    ):
        hhr.build(full, sets[0], returning(model.changed(fields=fields(**own))), sets[1])


def test_k_of_the_bodies_at_a_point_has_their_response():
    """It was given the response K^-1 B^T of the middle of the box."""

    class Sometimes(Foundation):
        def equations(self, point, theta):
            problem, stiffness, loads = super().equations(point, theta)
            return (
                problem,
                stiffness if point[self.axis] else self.made(problem.own_stiffness, problem),
                loads,
            )

    point = [0.05, 0.0, 0.05, 0.0, 0.0]
    found = hhr.FullOrderModel(joined(Sometimes, constraints=(), loads=())).solve(point)
    with pytest.warns(hhr.errors.SceneWarning):
        exact = hhr.FullOrderModel(joined(None, constraints=(), loads=())).solve(point)
    assert largest_difference(found.displacement(), exact.displacement()) <= 1e-10


PROGRAM = """
import json, sys
sys.path[:0] = {folders!r}
import numpy as np
import hhr_dolfinx as hhr
from mpi4py import MPI
from my_system import MySystem
from test_restricted import joined
from toy_system import Foundation, Parted
comm = MPI.COMM_WORLD
out = {{}}
for name, system in (("foundation", Foundation), ("parts", Parted), ("template", MySystem("k"))):
    full = hhr.FullOrderModel(joined(system))
    models = [("full", full)]
    if system is not Foundation:
        training = hhr.train(joined(system), hhr.Sobol(12), held_out=2, together=True)
        models += [("gathered", full.gathered()), ("condensed", training.condense())]
        models.append(("reduced", training.build()))
    for kind, model in models:
        answer = model.solve([0.04, 0.01, 0.03, 0.0, 6.0], gradient=True, outside="ignore")
        u = answer.displacement()
        points = full.problem.points.round(9)
        # nodes of both sides of the contact have one place
        parts = []
        for part in u.reshape(points.shape).T:
            parts.append(part[np.lexsort((part.round(9), *points.T))].tolist())
        out[f"{{name}}, {{kind}}"] = [
            answer.forces().tolist(), parts, answer.gradient.multipliers.tolist()
        ]
every = comm.allgather(json.dumps(out))
assert len(set(every)) == 1
if comm.rank == 0:
    print("OUT" + every[0])
"""


@pytest.fixture(scope="module")
def on_one():
    return on_ranks(1)


def on_ranks(ranks):
    """Answers of a program on some ranks, by system and model."""
    said = launch(
        ranks,
        [
            "-W",
            "ignore",
            "-c",
            PROGRAM.format(folders=[*folders_of(__file__), TEMPLATE]),
        ],
    )
    return json.loads(said.partition("OUT")[2].splitlines()[0])


@pytest.mark.slow
@needs("ranks", "moduli")
@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks_answer_alike(on_one, ranks):
    """A gathered model had its foundation twice: its parts were K of the bodies of another such
    system.
    """
    found = on_ranks(ranks)
    assert found.keys() == on_one.keys()
    for name, arrays in on_one.items():
        exact = on_one[f"{name.partition(',')[0]}, full"]
        tolerance = 1e-9 if name.endswith(("full", "gathered")) else 1e-5
        for one, other, full in zip(found[name], arrays, exact, strict=True):
            assert largest_difference(one, other) <= tolerance, name
            assert largest_difference(one, full) <= (1e-9 if "gathered" in name else 0.05), name


def test_the_example_of_the_page(tmp_path):
    """The stiffness of another code, with its own numbers of nodes, in the place of that of a
    body.
    """
    page = (Path(__file__).parents[3] / "docs" / "systems.md").read_text("utf-8")
    scope = {"__name__": "example"}
    exec(page.partition("```python\n")[2].partition("```")[0], scope)
    end = block.side(1, upper=True)
    corners = hhr.Nodes.near((0.0, 1.0)), hhr.Nodes.near((1.0, 1.0))
    given = {
        "contacts": (hhr.Obstacle(block.side(1, upper=False), (0.0, -1.0), 0.01),),
        "displacements": (hhr.Displacement(end, 1, hhr.Amplitude(slopes={"push": -1.0})),),
        "constraints": (hhr.Equation(((corners[0], 0, 1.0), (corners[1], 0, 1.0))),),
        "loads": (hhr.Springs(corners[0], 0, 0.1), hhr.Pressure(block.side(0, upper=True), 0.02)),
    }
    box = {"push": (0.0, 0.1), "E": (1.0, 3.0)}
    exact = hhr.FullOrderModel(block_scene("exact", box, young="E", **given))
    held = {"constraints": (), "loads": (), "displacements": hhr.Displacement.clamp(end, 2)}
    with pytest.warns(hhr.errors.SceneWarning, match="E"):
        unit = hhr.FullOrderModel(block_scene("unit", box, **given | held))
    order = np.random.default_rng(0).permutation(len(unit.problem.points))
    dofs = (2 * order[:, None] + np.arange(2)).ravel()
    save_npz(tmp_path / "k.npz", csr_matrix(unit.problem.stiffness[dofs][:, dofs]))
    np.save(tmp_path / "nodes.npy", unit.problem.points[order])
    system = scope["OfFiles"](str(tmp_path / "k.npz"), str(tmp_path / "nodes.npy"))
    full = hhr.FullOrderModel(block_scene("theirs", box, system=system, **given))
    for point in full.parameters.random(4, 0):
        one, other = (model.solve(point, gradient=True) for model in (full, exact))
        assert largest_difference(one.displacement(), other.displacement()) <= 1e-10
        assert np.abs(one.forces() - other.forces()).max() <= 1e-10
        assert largest_difference(one.gradient.unknown, other.gradient.unknown) <= 1e-8


@dataclasses.dataclass(frozen=True)
class Summed(MySystem):
    """The sum of the template, with something changed."""

    changes: object

    def __call__(self, *given):
        system = super().__call__(*given)
        system.problem = dataclasses.replace(system.problem, **self.changes(system.problem))
        return system


TERMS = [
    (lambda p: {"moduli": p.moduli[:1]}, "has 1 weights of 2 matrices"),
    (
        lambda p: {"moduli": (p.moduli[0], Modulus("k", "1", p.moduli[1].names[::-1]))},
        "must name all parameters",
    ),
    (
        lambda p: {"stiffness_terms": (p.stiffness_terms[0], p.stiffness_terms[1].toarray())},
        "is no csr_matrix in the",
    ),
    (
        lambda p: {"stiffness_terms": (p.stiffness_terms[0], p.stiffness_terms[1][:-1])},
        "is no csr_matrix in the",
    ),
    (
        lambda p: {"stiffness_terms": (p.stiffness_terms[0], p.mass @ p.mass)},
        "is no csr_matrix in the",
    ),
]


@needs("conformance")
@pytest.mark.parametrize(("changes", "why"), TERMS)
def test_terms_that_do_not_go_together_are_refused(changes, why):
    from hhr_dolfinx.testing import pressed_blocks

    with pytest.raises(SceneError, match=why):
        hhr.FullOrderModel(pressed_blocks({"k": (0.1, 20.0)}, system=Summed("k", changes)))


class OfTheMiddle(MySystem):
    """Leaves out that moduli of bodies are parameters."""

    def __call__(self, problem, middle, made):
        constant = dataclasses.replace(problem, moduli=(), stiffness_terms=(problem.own_stiffness,))
        return super().__call__(constant, middle, made)


@needs("conformance")
@pytest.mark.parametrize("system", [MySystem, OfTheMiddle])
def test_moduli_that_a_system_leaves_out_are_named(system, recwarn):
    """Bodies of the modulus E answer alike for every E, which a warning says."""
    from hhr_dolfinx.testing import BOX, LOWER_BODY, UPPER_BODY, pressed_blocks

    bodies = hhr.Body(LOWER_BODY, "E", 0.3), hhr.Body(UPPER_BODY, 5.0, 0.3)
    box = {"k": (0.1, 20.0), "E": (1.0, 4.0)}
    full = hhr.FullOrderModel(pressed_blocks(box, bodies=bodies, system=system("k")))
    said = [
        str(item.message) for item in recwarn if "K of its system does not" in str(item.message)
    ]
    point = {name: 0.5 * sum(ends) for name, ends in {**BOX, "k": (0.1, 20.0)}.items()}
    soft, stiff = (full.solve({**point, "E": modulus}).forces() for modulus in (1.0, 4.0))
    alike = np.abs(soft - stiff).max() <= 1e-12 * np.abs(stiff).max()
    assert len(said) == alike == (system is OfTheMiddle)
    assert all("depend on E" in words for words in said)


@needs("conformance")
@pytest.mark.parametrize("constraints", [False, True])
def test_gaps_and_loads_of_another_problem_are_refused(constraints):
    """They are compared with those of the scene, not with those of the system itself."""
    from hhr_dolfinx.testing import pressed_blocks

    left, right, _ = places()
    more = (
        {"constraints": (hhr.Equation(((left, 0, 1.0), (right, 0, -2.0))),)} if constraints else {}
    )
    for changes, what in (
        (lambda p: {"gaps": 1.5 * p.gaps}, "the gaps"),
        (lambda p: {"forces": 1.5 * p.forces}, "the loads"),
        (lambda p: {"contact": 1.5 * p.contact}, "B"),
    ):
        with pytest.raises(SceneError, match=f"parts, and {what} of its equations"):
            hhr.FullOrderModel(
                pressed_blocks({"k": (0.1, 20.0)}, system=Summed("k", changes), **more)
            )
