"""Formulas of parameters: values, exact derivatives, what is no formula, and that no text is ever
executed.
"""

import contextlib
import math
import pickle
import sys
import warnings

import numpy as np
import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ParameterError, SceneError
from hhr_dolfinx.formulas import (
    DEEPEST_FORMULA,
    LONGEST_FORMULA,
    Formula,
    Modulus,
    Scalar,
    box_samples,
    check_over_box,
    formula_of,
)

POINT = {"x": 0.7, "y": -1.3, "T": 350.0}
NAMES = tuple(POINT)
AT = np.array(list(POINT.values()))
TABLE = "table(T, 300, 2, 400, 4, 500, -2)"

# text, value, derivatives along x, y and T, each by hand
CLOSED = [
    ("3", 3.0, (0, 0, 0)),
    ("-x", -0.7, (-1, 0, 0)),
    ("+x - -y", -0.6, (1, 1, 0)),
    ("2**3**2", 512.0, (0, 0, 0)),
    ("-x**2", -0.49, (-1.4, 0, 0)),
    ("1e3 * x / 4", 175.0, (250, 0, 0)),
    ("x - y - 1", 1.0, (1, -1, 0)),
    ("8 / x / 2", 4 / 0.7, (-4 / 0.49, 0, 0)),
    ("y**3", -(1.3**3), (0, 3 * 1.69, 0)),
    ("y**-2", 1.3**-2, (0, 2 * 1.3**-3, 0)),
    ("y**120 / y**119", -1.3, (0, 1, 0)),
    ("x**y", 0.7**-1.3, (-1.3 * 0.7**-2.3, 0.7**-1.3 * math.log(0.7), 0)),
    ("x**0", 1.0, (0, 0, 0)),
    ("(x - 0.7)**2", 0.0, (0, 0, 0)),
    ("sqrt(x)", math.sqrt(0.7), (0.5 / math.sqrt(0.7), 0, 0)),
    ("exp(x * y)", math.exp(-0.91), (-1.3 * math.exp(-0.91), 0.7 * math.exp(-0.91), 0)),
    ("log(x)", math.log(0.7), (1 / 0.7, 0, 0)),
    ("sin(x) * cos(y)", math.sin(0.7) * math.cos(1.3),
     (math.cos(0.7) * math.cos(1.3), math.sin(0.7) * math.sin(1.3), 0)),
    ("tan(x)", math.tan(0.7), (1 + math.tan(0.7) ** 2, 0, 0)),
    ("tanh(y)", math.tanh(-1.3), (0, 1 - math.tanh(1.3) ** 2, 0)),
    ("tanh(T)", 1.0, (0, 0, 0)),
    ("abs(y) + abs(x)", 2.0, (1, -1, 0)),
    ("min(x, y) + 10 * max(x, y)", 5.7, (10, 1, 0)),
    ("max(min(x, 0.5), 0)", 0.5, (0, 0, 0)),
    ("pi * x", math.pi * 0.7, (math.pi, 0, 0)),
    (TABLE, 3.0, (0, 0, 0.02)),
    ("table(T + 100, 300, 2, 400, 4, 500, -2)", 1.0, (0, 0, -0.06)),
    ("table(x * T, 0, 0, 1000, 10)", 2.45, (3.5, 0, 0.007)),
    ("210e3 * (1 - 5e-4 * (T - 293))", 210e3 * (1 - 0.0285), (0, 0, -105)),
]  # fmt: skip


@pytest.mark.parametrize(("text", "value", "slopes"), CLOSED, ids=[item[0] for item in CLOSED])
def test_values_and_derivatives_by_hand(text, value, slopes):
    scalar = Scalar(text, NAMES)
    assert scalar.value(AT) == pytest.approx(value, rel=1e-14, abs=1e-15)
    assert type(scalar.value(AT)) is float
    assert scalar.derivative(AT) == pytest.approx(slopes, rel=1e-13, abs=1e-13)
    assert scalar(AT) == ([0], [scalar.value(AT)])
    assert scalar.values(np.stack([AT, AT])) == pytest.approx(2 * [scalar.value(AT)], rel=1e-15)


def random_text(rng, depth):
    """A smooth formula that is defined everywhere."""
    if depth == 0:
        return str(rng.choice(["x", "y", "T", "0.3", "2"]))
    one, other = random_text(rng, depth - 1), random_text(rng, depth - 1)
    kinds = [
        "({0} + {1})",
        "({0} - {1})",
        "({0} * {1})",
        "({0} / (2 + sin({1})))",
        "sin({0}) * tanh({1})",
        "sqrt(1 + ({0})**2)",
        "exp(-abs(sin({0})) - 1)",
        "log(3 + cos({0}))",
        "(2 + sin({0}))**(cos({1}))",
    ]
    return str(rng.choice(kinds)).format(one, other)


@pytest.mark.parametrize("seed", range(20))
def test_values_are_those_of_numpy_and_derivatives_those_of_differences(seed):
    rng = np.random.default_rng(seed)
    text, point = random_text(rng, 3), rng.uniform(0.2, 2.0, 3)
    scalar = Scalar(text, NAMES)
    functions = {
        name: getattr(np, name) for name in ("sin", "cos", "tanh", "sqrt", "exp", "log", "abs")
    }
    assert scalar.value(point) == pytest.approx(
        float(eval(text, functions, dict(zip(NAMES, point, strict=True))))
    )
    around = [
        (scalar.value(point + step) - scalar.value(point - step)) / 2e-5
        for step in 1e-5 * np.eye(3)
    ]
    found = scalar.derivative(point)
    assert np.abs(found - around).max() < 1e-6 * (
        1 + np.abs(found).max() + abs(scalar.value(point))
    )


def test_arrays_are_answered_like_numbers():
    xs = np.linspace(-2, 2, 9)
    for text in ("x**2 + abs(x)", "table(x, -2, 0, 0, 1, 2, -5)", "max(x, 0.25) * min(x, y)"):
        formula = Formula(text)
        assert np.array_equal(
            formula({"x": xs, "y": 0.1}), [float(formula({"x": x, "y": 0.1})) for x in xs]
        )


def test_a_table_is_linear_and_refuses_what_is_beyond():
    def at(temperature):
        return Scalar(TABLE, NAMES).value(np.array([0.0, 0.0, temperature]))

    assert [at(item) for item in (300, 325, 400, 450, 500)] == pytest.approx([2, 2.5, 4, 1, -2])
    assert at(500 + 1e-8) == pytest.approx(-2)  # round-off is not beyond
    for temperature in (299.0, 501.0):
        with pytest.raises(
            ParameterError, match=f"{temperature:g} is outside the table from 300 to 500"
        ):
            at(temperature)


NO_FORMULAS = [
    "",
    "   ",
    "x +",
    "x y",
    "x; y",
    "x\ny",
    "x\x00",
    "x, y",
    "(x, y)",
    "[x]",
    "{x}",
    "{}",
    "'x'",
    "b'x'",
    "f'{x}'",
    "1j",
    "True",
    "None",
    "...",
    "x < y",
    "x == y",
    "x // y",
    "x % y",
    "x @ y",
    "x << 2",
    "x & y",
    "~x",
    "not x",
    "x and y",
    "x if y else T",
    "x[0]",
    "x.real",
    "x.__class__",
    "().__class__.__bases__",
    "lambda: 1",
    "(z := 3)",
    "z = 3",
    "import os",
    "__import__('os')",
    "__import__",
    "open('/etc/passwd')",
    "eval('1')",
    "exec('1')",
    "print(x)",
    "float(x)",
    "round(x)",
    "sqrt",
    "table",
    "sqrt.__call__(x)",
    "(sqrt)(x)(y)",
    "sqrt(x)(y)",
    "sqrt(x, y)",
    "sqrt()",
    "sqrt(x=1)",
    "sqrt(*x)",
    "min(x)",
    "max(x, y, T)",
    "pi(x)",
    "[x for x in y]",
    "await x",
    "yield x",
    "*x",
    "x!",
    "x$",
    "2x",
    "1e999",
    "x # E in MPa",
    "9" * 400,
    "9" * 5000,
    "x" * (LONGEST_FORMULA + 1),
    "(" * 300 + "x" + ")" * 300,
    "-" * 5000 + "x",
    "+".join(["x"] * 5000),
    "sqrt(" * 900 + "x" + ")" * 900,
    "table()",
    "table(x)",
    "table(x, 1, 2)",
    "table(x, 1, 2, 3)",
    "table(x, 1, 2, 1, 3)",
    "table(x, 2, 2, 1, 3)",
    "table(x, 0, y, 1, 2)",
    "table(x, 0, 1/0, 1, 2)",
    "table(x, 0, 0, 1, (-8)**0.5)",
    "table(x, 0, 10**400, 1, 2)",
    "table(x, 0, log(0), 1, 2)",
    "x\\\n+ y\n+",
    "x ∙ y",
]


@pytest.mark.parametrize("text", NO_FORMULAS, ids=lambda text: text[:30])
def test_what_is_no_formula_is_refused_in_words(text):
    with warnings.catch_warnings(
        action="ignore", category=SyntaxWarning
    ):  # Python's own, of texts such as 2x
        with pytest.raises(SceneError) as caught:
            Scalar(text, NAMES)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize("text", [None, 3, 2.5, b"x", ["x"], object])
def test_what_is_no_text_is_refused(text):
    with pytest.raises(SceneError, match="a formula must be a text"):
        Formula(text)


def test_nothing_of_a_text_is_executed():
    """Of all that is compiled, called or imported, Python tells its audit hooks."""
    seen, watching = [], []

    def hook(event, arguments):
        if watching and event in ("exec", "import", "open", "os.system", "subprocess.Popen"):
            seen.append(event)

    texts = [
        "__import__('os').system('true')",
        "(lambda: x)()",
        "[open(y) for y in x]",
        "x.__init__",
        "sqrt(x) + y",
    ]

    def tried():
        for text in texts:
            with contextlib.suppress(SceneError):
                Formula(text)({"x": 2.0, "y": 1.0})

    tried()  # whatever refusing them loads is there
    sys.addaudithook(hook)
    watching.append(True)
    tried()
    watching.clear()
    assert seen == []


@pytest.mark.parametrize(
    "text",
    [
        "(-8)**0.5",
        "x * (-8)**0.5",
        "x + (-8)**0.5",
        "y**0.5",
        "sqrt(y)",
        "log(y)",
        "1/0",
        "x/(y - y)",
        "10**400",
    ],
)
def test_where_it_has_no_value_it_says_nan_or_infinity_and_nothing_else(text):
    with warnings.catch_warnings(action="error"):
        assert not math.isfinite(Scalar(text, NAMES).value(AT))
        # of Python's own numbers too, which make a complex one of a root
        assert not np.isfinite(Formula(text)(POINT)) and not np.iscomplexobj(Formula(text)(POINT))
        Scalar(text, NAMES).derivative(AT)


def test_huge_powers_end_at_once():
    assert math.isnan(Scalar("9**9**9**9**9", ()).value(np.zeros(0)))
    assert math.isnan(Scalar("(10**300)**2 - x", NAMES).value(AT))


def test_what_was_accepted_is_answered_from_deep_within_a_program_too():
    formula = Formula("+".join(["x"] * (DEEPEST_FORMULA - 1)))

    def deep(levels):
        return formula({"x": 1.0}) if levels == 0 else deep(levels - 1)

    assert deep(300) == DEEPEST_FORMULA - 1
    with pytest.raises(SceneError, match=f"nests more than {DEEPEST_FORMULA}"):
        Formula("+".join(["x"] * (DEEPEST_FORMULA + 1)))
    assert Formula("+".join(["(" + "+".join(["x"] * 100) + ")"] * 90))({"x": 1.0}) == 9000


def test_names():
    """Parameters may have any name that can be read, those of functions too; not that of pi."""
    assert Scalar("exp(exp) * log", ("exp", "log")).value(np.array([0.0, 3.0])) == 3.0
    assert Scalar("θ * E_0", ("θ", "E_0")).value(np.array([2.0, 3.0])) == 6.0
    assert Formula("b + a + b").variables == ("b", "a")
    with pytest.raises(SceneError, match=r"names \['z'\], the parameters are \('x', 'y', 'T'\)"):
        Scalar("x * z", NAMES)
    with pytest.raises(SceneError, match="named 'pi'"):
        Scalar("2 * pi", ("pi",))


def test_numbers_and_texts_as_formulas():
    assert formula_of(-2, "E").text == "-2.0" and formula_of(np.float64(0.1), "E")({}) == 0.1
    assert formula_of(Formula("x"), "E") is not None and formula_of("x", "E") == Formula("x")
    assert Formula("x + y").times(Formula("x - y"))(POINT) == pytest.approx(0.49 - 1.69)
    for value in (math.nan, math.inf, True, None, 1j, [1]):
        with pytest.raises(SceneError, match=r"the modulus = .* must be a finite number"):
            formula_of(value, "the modulus")
    with pytest.raises(SceneError, match=r"the modulus: the formula 'x \+.* cannot be read"):
        formula_of("x +", "the modulus")


def test_a_modulus_is_a_product_and_its_derivative():
    modulus = Modulus("T * x", "1 / (1 + y**2)", NAMES)
    whole = Scalar("(T * x) * (1 / (1 + y**2))", NAMES)
    assert modulus.value(AT) == pytest.approx(whole.value(AT), rel=1e-15)
    assert modulus.derivative(AT) == pytest.approx(whole.derivative(AT), rel=1e-13)
    with pytest.raises(SceneError, match="z"):
        Modulus("x", "z", NAMES)


@pytest.mark.parametrize(
    "item", [Formula("x * y"), Scalar("x * y", NAMES), Modulus("x", TABLE, NAMES)]
)
def test_copies_by_pickle_are_texts_and_answer_alike(item):
    for fresh in (item, pickle.loads(pickle.dumps(item))):
        again = pickle.loads(pickle.dumps(fresh))
        assert again == item and hash(again) == hash(item)
        if not isinstance(item, Formula):
            assert again.value(AT) == item.value(AT)
    assert b"lambda" not in pickle.dumps(item) and b"_compiled" not in pickle.dumps(item)


def test_bounds_are_asked_for_all_over_the_box():
    space = hhr.ParameterSpace(("x", "T"), (-1.0, 300.0), (1.0, 400.0))
    samples = box_samples(space)
    assert {(-1.0, 300.0), (1.0, 400.0), (-1.0, 400.0), (1.0, 300.0), (0.0, 350.0)} <= set(
        map(tuple, samples)
    )
    check_over_box(Scalar("2 + x", space.names), space, "E", 0.0, math.inf, "narrow")
    for text, said in (
        ("1 + x", "E = 1 \\+ x is 0 at x = -1, T = "),  # zero in a corner only
        ("0.09 - x**2 * (1 - x**2) * (1 - x**2) + x**6", "is -"),  # below zero between
        ("1 + x**2 + 0 * (x + 0.99)**0.5", "is nan at x = -1"),
        ("1 / (x - x)", "inf|nan"),
        (
            "table(T, 300, 1, 390, 2)",
            "outside the table from 300 to 390. Give the table further points",
        ),
    ):
        with pytest.raises(SceneError, match=said):
            check_over_box(Scalar(text, space.names), space, "E", 0.0, math.inf, "narrow")


def test_many_parameters_have_too_many_corners_to_try_them_all():
    samples = box_samples(hhr.ParameterSpace(tuple("abcdefghijkl"), (0.0,) * 12, (1.0,) * 12), 5)
    assert samples.shape == (1 + 2**10 + 5, 12) and samples.min() >= 0 and samples.max() <= 1
