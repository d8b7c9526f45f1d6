"""Warnings that a block ignores or collects: of its own thread alone, and heard again where they are repeated."""

import threading
import warnings

import pytest
from threads import at_once

from hhr_dolfinx.errors import PairingWarning, SceneWarning
from hhr_dolfinx.warn import collected, ignored, repeat, warn


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
