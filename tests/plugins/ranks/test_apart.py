"""Ranks that differ: calls with other arguments, code of the user that fails on one, tables of
other lengths.
"""

import json

import pytest
from mpirun import launch, run_program
from processes import folders_of

PROGRAM = f"""
import json, sys
sys.path[:0] = {folders_of(__file__)!r}
import apart
found = apart.outcomes()
if apart.COMM.rank == 0:
    print(json.dumps(found))
"""
LIMIT = 120
"""Seconds after which a run is held to hang."""


@pytest.fixture(scope="module", params=[2, pytest.param(3, marks=pytest.mark.slow)])
def found(request):
    return json.loads(launch(request.param, ["-c", PROGRAM]).splitlines()[-1])


def test_tables_of_other_lengths_are_refused_on_all_ranks(found):
    """A whole table where local rows are due was written behind the end of a buffer: hhr solve on
    two ranks crashed.
    """
    for name, texts in found["tables"].items():
        assert all(
            text.startswith("RankError: ") and "pass the local rows" in text.lower()
            for text in texts
        ), name
    for name in ("whole tables", "a whole table on one rank", "more columns on one rank"):
        assert len(set(found["tables"][name])) == 1, name


def test_ranks_that_ask_different_things_are_told_the_same(found):
    for name, texts in found["questions"].items():
        if name == "no point":
            assert all(
                text.startswith("ParameterError: ") and "nan is not finite" in text
                for text in texts
            )
            continue
        assert len(set(texts)) == 1, name
        assert texts[0].startswith("RankError: ") and "requests of ranks differ" in texts[0], name
        assert "Ask the same on all ranks" in texts[0], name
    solve = found["questions"]["solve"][0]
    last = len(found["after"]) - 1
    assert (
        "rank 0 requests solve at push = 0.03" in solve
        and f"rank {last} requests solve at push = 0.04" in solve
    )
    assert (
        "young=10.0" in found["questions"]["scenes"][0]
        and "young=11.0" in found["questions"]["scenes"][0]
    )


def test_failures_of_user_code_on_one_rank_are_raised_on_all(found):
    for name, texts in found["failures"].items():
        *others, last = texts
        if name == "short":
            assert len(set(texts)) == 1 and "ends on rank" in last
        elif name == "reduce":  # the first rank alone searches
            assert texts[0].startswith("ZeroDivisionError") and all(
                "failed on rank 0" in text for text in texts[1:]
            )
        else:
            word = "SystemExit: 7" if "exit" in name else "OSError: no terminal"
            assert last == word, name
            assert all(text.startswith("RankError: ") and word in text for text in others), name


def test_the_model_answers_after_all_of_these(found):
    """The same forces on each rank."""
    first, *others = found["after"]
    assert max(first) > 0 and all(forces == first for forces in others)


SCENE = f"""
import sys
sys.path[:0] = {folders_of(__file__)!r}
from apart import LAST, Broken, pair
{{failure}}
scene = pair({{changes}})
"""
STIFFER = 'system=Broken, parameters={"k": (0.0, 5.0)}'


@pytest.mark.parametrize(
    ("failure", "changes", "words", "code", "said"),
    [
        ("if LAST: raise ValueError('no scene')", "", [], 3, "ValueError: no scene"),
        pytest.param("if LAST: sys.exit(5)", "", [], 3, "SystemExit: 5", marks=pytest.mark.slow),
        pytest.param(
            "",
            STIFFER,
            ["--at", "push=0.05,slide=0,load=0,gap=0,k=1"],
            1,
            "no equations here",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_command_that_fails_on_one_rank_ends_on_all(
    tmp_path, failure, changes, words, code, said
):
    """It says why once, and ends with the code of the failure."""
    path = tmp_path / "scene.py"
    path.write_text(SCENE.format(failure=failure, changes=changes))
    run = run_program(
        2, ["-m", "hhr_dolfinx.command.main", "solve", str(path), *words], limit=LIMIT
    )
    assert run.returncode == code, run.stderr
    assert said in run.stderr and "failed on rank 1 of 2, and the others wait for it" in run.stderr
    assert "sum of contact forces" not in run.stdout
