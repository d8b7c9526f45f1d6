"""Programs of formulas in UFL: values, derivatives, what they share, and what is refused."""

import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import ufl
from needs import needs

import hhr_dolfinx
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.ufl_programs.forward import Forward
from hhr_dolfinx.plugins.ufl_programs.from_ufl import nodes_of, symbols
from hhr_dolfinx.plugins.ufl_programs.graph import OPERATIONS, Graph
from hhr_dolfinx.plugins.ufl_programs.machine import evaluated
from hhr_dolfinx.plugins.ufl_programs.program import CODES, Order, Program

SINGLE = {
    "sqrt": (ufl.sqrt, np.sqrt),
    "exp": (ufl.exp, np.exp),
    "log": (ufl.ln, np.log),
    "abs": (abs, np.abs),
    "sin": (ufl.sin, np.sin),
    "cos": (ufl.cos, np.cos),
    "tan": (ufl.tan, np.tan),
    "asin": (ufl.asin, np.arcsin),
    "acos": (ufl.acos, np.arccos),
    "atan": (ufl.atan, np.arctan),
    "sinh": (ufl.sinh, np.sinh),
    "cosh": (ufl.cosh, np.cosh),
    "tanh": (ufl.tanh, np.tanh),
    "neg": (lambda x: -x, lambda x: -x),
    "power": (lambda x: x**2.5, lambda x: x**2.5),
    "cube": (lambda x: x**3, lambda x: x**3),
    "inverse": (lambda x: x**-2, lambda x: x**-2.0),
    "root": (lambda x: x**-0.5, lambda x: x**-0.5),
    "twice": (lambda x: 3 * (2 * x), lambda x: 6 * x),
    "quotient": (lambda x: 2 / x - x / 4, lambda x: 2 / x - x / 4),
}
PAIRS = {
    "atan2": (ufl.atan2, np.arctan2),
    "max": (ufl.max_value, np.maximum),
    "min": (ufl.min_value, np.minimum),
    "pow": (lambda x, y: x**y, np.power),
    "mul": (lambda x, y: x * y, np.multiply),
    "div": (lambda x, y: x / y, np.divide),
    "sub": (lambda x, y: x - y, np.subtract),
    "lt": (
        lambda x, y: ufl.conditional(ufl.lt(x, y), x, 2 * y),
        lambda x, y: np.where(x < y, x, 2 * y),
    ),
    "ge": (
        lambda x, y: ufl.conditional(ufl.ge(x, y), x, y * y),
        lambda x, y: np.where(x >= y, x, y * y),
    ),
    "and": (
        lambda x, y: ufl.conditional(ufl.And(x > 0.3, y > 0.3), x, y),
        lambda x, y: np.where((x > 0.3) & (y > 0.3), x, y),
    ),
    "or": (
        lambda x, y: ufl.conditional(ufl.Or(x > 0.6, y > 0.6), x, y),
        lambda x, y: np.where((x > 0.6) | (y > 0.6), x, y),
    ),
    "not": (lambda x, y: ufl.conditional(ufl.Not(x > y), x, y), lambda x, y: np.where(x > y, y, x)),
}


def made(state, **sizes):
    """Program of the values of an expression of scalars, and of its derivatives by them."""
    graph, found = Graph(), symbols(**dict.fromkeys(sizes, ()))
    inputs = {found[name]: [graph.input(name)] for name in sizes}
    nodes = nodes_of(graph, state(*found.values()), inputs)
    every = [node for (node,) in inputs.values()]
    return Program.of(graph, sizes, [nodes, graph.jacobian(nodes, every)])


@pytest.mark.parametrize("name", [*SINGLE, *PAIRS])
def test_forward_derivatives_are_those_of_the_graph(name):
    """Along three directions, of a program without any derivative in it."""
    stated, _ = (SINGLE | PAIRS)[name]
    sizes = {"x": 1} if name in SINGLE else {"x": 1, "y": 1}
    rng = np.random.default_rng(0)
    given = rng.uniform(0.05, 0.95, (len(sizes), 200))
    ways = rng.standard_normal((len(sizes), 200, 3))
    program = made(stated, **sizes)
    forward = Forward(program, given, ways)
    forward.run(0)
    values, slopes = forward.outputs(0)
    assert values[0] == pytest.approx(evaluated(program, given)[0], rel=1e-14)
    assert slopes[0] == pytest.approx(
        np.einsum("in,ink->nk", evaluated(program, given, 1), ways), rel=1e-13, abs=1e-15
    )


def test_forward_derivatives_find_the_distance_to_kinks():
    """|x - 2 y| along (x', y'): after |x - 2 y| / |x' - 2 y'|; none along (2, 1).

    There it stays the same.
    """
    program = made(lambda x, y: abs(x - 2 * y), x=1, y=1)
    given = np.array([[1.0, 2.0], [0.2, 1.0]])
    forward = Forward(
        program, given, np.array([[[1.0, 2.0], [1.0, 2.0]], [[0.0, 1.0], [0.0, 1.0]]])
    )
    forward.run(0)
    assert forward.reach[:, 0] == pytest.approx([0.6, 0.0], abs=1e-15)
    assert np.isinf(forward.reach[:, 1]).all()


@pytest.mark.parametrize("name", [*SINGLE, *PAIRS])
def test_operations_and_their_derivatives_are_those_of_numpy(name):
    """At 200 points: more than the machine takes together."""
    stated, known = (SINGLE | PAIRS)[name]
    sizes = {"x": 1} if name in SINGLE else {"x": 1, "y": 1}
    given = np.random.default_rng(0).uniform(0.05, 0.95, (len(sizes), 200))
    program = made(stated, **sizes)
    assert evaluated(program, given)[0] == pytest.approx(known(*given), rel=1e-14)
    slopes = evaluated(program, given, 1)
    for place in range(len(sizes)):
        step = 1e-7 * np.eye(len(sizes))[place][:, None]
        slope = (known(*(given + step)) - known(*(given - step))) / 2e-7
        smooth = np.abs(slope) < 1e4  # not across the jump of a conditional
        assert slopes[place][smooth] == pytest.approx(slope[smooth], rel=1e-5, abs=1e-6)


def test_tensors_are_taken_component_by_component():
    """Products, inverse, determinant, indices, derivatives in UFL itself."""
    graph, found = Graph(), symbols(a=(3, 3), b=(3,))
    inputs = {
        found["a"]: [graph.input("a", k) for k in range(9)],
        found["b"]: [graph.input("b", k) for k in range(3)],
    }
    a, b = found["a"], ufl.variable(found["b"])
    i, j = ufl.indices(2)
    inverse = ufl.dot(ufl.inv(a), b)
    squares = ufl.diff(ufl.dot(b, a * b), b)
    contracted = ufl.as_vector(a[i, j] * b[j], i)
    parts = [
        nodes_of(graph, part, inputs)
        for part in (inverse, squares, contracted, ufl.det(a) * ufl.dev(a))
    ]
    program = Program.of(graph, {"a": 9, "b": 3}, parts)
    rng = np.random.default_rng(1)
    matrix, vector = rng.normal(size=(3, 3)) + 3 * np.eye(3), rng.normal(size=3)
    given = np.concatenate([matrix.ravel(), vector])[:, None]
    deviator = matrix - np.trace(matrix) / 3 * np.eye(3)
    known = (
        np.linalg.solve(matrix, vector),
        (matrix + matrix.T) @ vector,
        matrix @ vector,
        np.linalg.det(matrix) * deviator,
    )
    for part, value in enumerate(known):
        assert evaluated(program, given, part)[:, 0] == pytest.approx(value.ravel(), rel=1e-12)


def test_quotients_of_zeros_fold_away_before_they_are_differentiated():
    """x/q at q = 0: replaced by a constant before, the graph has no 0/0."""
    graph = Graph()
    x, q = graph.input("x"), graph.input("q")
    share = graph.apply("div", graph.apply("mul", x, q), q)
    (rest,) = graph.substituted([share], {x: graph.const(0)})
    assert graph.number(rest) == 0
    assert graph.number(graph.apply("div", q, q)) == 1


def test_values_that_parts_share_are_computed_once():
    """Before the parts that need them, but not by what moves in between."""
    graph = Graph()
    x, y = graph.input("x"), graph.input("y")
    heavy = graph.apply("exp", graph.apply("mul", x, x))
    both = [[graph.apply("add", heavy, y)], [graph.apply("mul", heavy, graph.apply("sin", y))]]
    order = Order((None, 0, 0), "y", frozenset({0}))
    program = Program.of(graph, {"x": 1, "y": 1}, [[x], *both], order)
    assert program.ends.tolist() == [2, 3, 5]
    given = np.array([[0.5], [0.25]])
    assert evaluated(program, given, 0, 2)[0, 0] == pytest.approx(math.exp(0.25) * math.sin(0.25))


CHANGES = {
    "operation": lambda p: p | {"rows": p["rows"] * [[100, 1, 1, 1, 1]]},
    "operand ahead": lambda p: p | {"rows": p["rows"] + [[0, 0, 50, 0, 0]]},
    "negative": lambda p: p | {"rows": p["rows"] - [[0, 0, 90, 0, 0]]},
    "result over an input": lambda p: p | {"rows": p["rows"] * [[1, 0, 1, 1, 1]]},
    "output": lambda p: p | {"outputs": p["outputs"] + 70},
    "registers": lambda p: p | {"registers": 10**9},
    "ends": lambda p: p | {"ends": p["ends"] + 1},
    "no parts": lambda p: p | {"ends": p["ends"][:0]},
}  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_programs_that_would_read_elsewhere_are_refused(change):
    program = made(lambda x, y: ufl.exp(x) * y + x / y, x=1, y=1)
    parts = {name: getattr(program, name) for name in Program.__dataclass_fields__}
    Program(**parts)
    with pytest.raises(SceneError, match="this is no program"):
        Program(**CHANGES[change](parts))


def test_a_program_with_random_changes_is_refused_or_computes():
    """Nothing else: no loop, no crash, no memory of its own."""
    program = made(lambda x, y: ufl.conditional(x > y, ufl.exp(x) * y, x / y) ** 2.5, x=1, y=1)
    parts = {name: getattr(program, name) for name in Program.__dataclass_fields__}
    rng, given, computed = np.random.default_rng(0), np.ones((2, 3)), 0
    for _ in range(500):
        rows = program.rows.copy()
        rows[rng.integers(len(rows)), rng.integers(5)] = rng.integers(-2, 40)
        try:
            changed = Program(**{**parts, "rows": rows})
        except SceneError:
            continue
        assert evaluated(changed, given).shape == (1, 3)
        computed += 1
    assert 0 < computed < 500


def test_what_programs_cannot_state_is_said():
    with pytest.raises(
        SceneError, match=r"BesselJ is no operation of a program, in .*: state it by sums"
    ):
        made(lambda x: ufl.bessel_J(1, x), x=1)
    assert set(CODES) == set(OPERATIONS) and CODES["add"] == 0


@needs("pages")
@pytest.mark.parametrize("language", ["js", "c"])
def test_operations_have_the_same_numbers_and_values_elsewhere(language, tmp_path):
    """Pages and C evaluate programs by machines that know the operations by their numbers."""
    tool = shutil.which({"js": "node", "c": "cc"}[language])
    if tool is None:
        pytest.skip("there is nothing to run it")
    folder = Path(hhr_dolfinx.__file__).parent / "plugins"
    calls = [
        (code, *given)
        for code in CODES.values()
        for given in ((0.3, 0.7, 2.0), (0.7, 0.3, 2.0), (0.0, 0.5, 0.5))
    ]
    if language == "js":
        names = (
            "exp",
            "log",
            "sin",
            "cos",
            "tan",
            "asin",
            "acos",
            "atan",
            "sinh",
            "cosh",
            "tanh",
            "pow",
            "atan2",
        )
        script = (
            "const code = "
            f"require('fs').readFileSync({str(folder / 'pages' / 'c' / 'contact_flow.wasm')!r});"
        )
        script += (
            f"const env = Object.fromEntries({[*names, 'hypot']}.map((name) => [name, "
            "Math[name]]));"
        )
        script += "env.formula = env.reached = () => 0;"
        script += (
            "const { operation } = new WebAssembly.Instance(new WebAssembly.Module(code), { env "
            "}).exports;"
        )
        script += (
            f"for (const given of {[list(call) for call in calls]}) "
            "console.log(operation(...given));"
        )
        command = [tool, "-e", script]
    else:
        text = (folder / "pages" / "c" / "programs.h").read_text()
        function = text[
            text.index("static inline double model_operation") : text.index(
                "static inline void model_run"
            )
        ]
        lines = "".join(
            f'printf("%.17g\\n", model_operation({code}, {a}, {b}, {c}));'
            for code, a, b, c in calls
        )
        source = tmp_path / "all.c"
        source.write_text(
            f"#include <math.h>\n#include <stdio.h>\n{function}\nint main(void) {{ {lines} }}"
        )
        subprocess.run([tool, "-std=c99", "-o", "all", "all.c", "-lm"], cwd=tmp_path, check=True)
        command = [tmp_path / "all"]
    told = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    for (code, *given), word in zip(calls, told, strict=True):
        row = [
            code,
            3,
            *(
                k if k < count else 0
                for k, count in zip(range(3), [list(OPERATIONS.values())[code]] * 3, strict=True)
            ),
        ]
        program = Program(
            np.array([row]), np.zeros(0), np.array([1]), np.array([3]), np.array([1]), 3, 4
        )
        exact = evaluated(program, np.array(given)[:, None])[0, 0]
        found = float(word.replace("Infinity", "inf"))
        assert found == pytest.approx(exact, rel=1e-15, nan_ok=True), list(OPERATIONS)[code]
