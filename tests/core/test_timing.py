"""The clock, and what it tells a logger of a long run."""

import logging

import pytest
from bare import python
from scenes import pressed_block

import hhr_dolfinx as hhr
from hhr_dolfinx.timing import StageLog


def test_a_build_tells_its_stages(caplog):
    training = hhr.train(pressed_block("plane_strain"), [8], held_out=20)
    with caplog.at_level(logging.DEBUG, logger="hhr_dolfinx"):
        training.build()
    told = [(record.levelno, record.getMessage()) for record in caplog.records]
    for stage in ("basis", "rid", "projection", "stability", "validation"):
        assert (logging.INFO, f"{stage} begins") in told
        assert any(level == logging.INFO and text.startswith(f"{stage} ends after ") for level, text in told)
    assert any(level == logging.DEBUG and text.startswith("indicator is left out: ") for level, text in told)
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
