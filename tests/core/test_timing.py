"""The clock, and what it tells a logger of a long run; warnings that a block ignores or collects.

A block takes those of its own thread alone, and they are heard again where they are repeated.
"""

import logging
import threading
import warnings

import pytest
from processes import python
from scenes import pressed_block
from threads import at_once

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import PairingWarning, SceneWarning
from hhr_dolfinx.timing import StageLog
from hhr_dolfinx.warn import collected, ignored, repeat, warn


def test_a_build_tells_its_stages(caplog):
    training = hhr.train(pressed_block("plane_strain"), [8], held_out=20)
    with caplog.at_level(logging.DEBUG, logger="hhr_dolfinx"):
        training.build()
    told = [(record.levelno, record.getMessage()) for record in caplog.records]
    for stage in ("basis", "rid", "projection", "stability", "validation"):
        assert (logging.INFO, f"{stage} begins") in told
        assert any(
            level == logging.INFO and text.startswith(f"{stage} ends after ")
            for level, text in told
        )
    assert any(
        level == logging.DEBUG and text.startswith("indicator is left out: ")
        for level, text in told
    )
    assert {record.name.split(".")[0] for record in caplog.records} == {"hhr_dolfinx"}


def test_a_refusal_is_told(caplog):
    log = StageLog()
    with caplog.at_level(logging.INFO, logger="hhr_dolfinx"):
        log.refuse("too wrong", layers=2)
    assert log.refused == [{"layers": 2, "why": "too wrong"}]
    assert caplog.messages == ["the model of layers 2 is refused: too wrong"]


def test_nothing_is_printed_by_default():
    program = (
        "from hhr_dolfinx.timing import StageLog\n"
        "log = StageLog()\n"
        "with log.stage('rid'): pass\n"
        "log.skip('rid', 'why'); log.refuse('why', layers=1)\n"
    )
    done = python("-c", program)
    assert (done.stdout, done.stderr) == ("", "")


def test_a_stage_that_fails_is_timed_and_its_seconds_add_up():
    log = StageLog()
    for _ in range(2):
        with pytest.raises(ValueError, match="no"), log.stage("rid"):
            raise ValueError("no")
    assert log.times.keys() == {"rid"} and log.times["rid"] > 0


def test_collected_warnings_are_silent_until_they_are_repeated():
    with warnings.catch_warnings(action="error"):
        with collected(SceneWarning) as found:
            warn("of a scene", SceneWarning)
            with pytest.raises(PairingWarning, match="of a pair"):
                warn("of a pair", PairingWarning)
    (item,) = found
    assert item.category is SceneWarning and item.filename == __file__
    with pytest.warns(SceneWarning, match="of a scene") as heard:
        repeat(found)
    assert (heard[0].filename, heard[0].lineno) == (item.filename, item.lineno)


def test_what_is_repeated_is_taken_by_the_block_around():
    with collected() as outer:
        with collected() as inner:
            warn("once", SceneWarning)
        assert not outer
        repeat(inner)
    assert outer == inner


def test_ignored_are_some_classes_and_sentences():
    with warnings.catch_warnings(action="error"):
        with ignored(SceneWarning, about="effect"):
            warn("has no effect", SceneWarning)
            with pytest.raises(SceneWarning):
                warn("is odd", SceneWarning)


def test_a_block_is_of_its_own_thread():
    inside, outside = threading.Barrier(2), threading.Barrier(2)

    def quiet():
        with ignored(Warning):
            inside.wait(timeout=20)
            outside.wait(timeout=20)

    def loud():
        inside.wait(timeout=20)
        with pytest.warns(SceneWarning):
            warn("is heard", SceneWarning)
        outside.wait(timeout=20)

    at_once([quiet, loud])


def test_warnings_name_the_line_that_called_the_package():
    """However deep in it they are, and through decorators of the standard library."""
    inside = {"__name__": "hhr_dolfinx.deep", "warn": warn}
    exec(
        "import contextlib\n@contextlib.contextmanager\ndef held():\n    yield\n"
        "@held()\ndef inner():\n    warn('deep', UserWarning)\ndef outer():\n    inner()\n",
        inside,
    )
    with pytest.warns(UserWarning, match="deep") as heard:
        inside["outer"]()
    assert heard[0].filename == __file__


def test_long_work_says_how_far_it_is_on_a_terminal_alone(monkeypatch, capsys):
    """Lines after two seconds, none into files or pipes, and items as they were."""
    import itertools
    import sys

    from hhr_dolfinx import timing

    clock = itertools.count(0.0, 3.0)
    monkeypatch.setattr(timing, "now", lambda: next(clock))
    assert list(timing.lines_of("snapshots")(range(3))) == [0, 1, 2] and not capsys.readouterr().err
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert list(timing.lines_of("snapshots")(range(3))) == [0, 1, 2]
    assert "s: snapshots" in capsys.readouterr().err
    assert list(timing.lines_of("greedy")(iter("ab"))) == ["a", "b"]
