"""Mutated files: each is refused by an error of this package, or answers as the original to the
last bit.

A child process with little memory reads the files one after another, so that one that kills or
swells it is found.
"""

import io
import json
import os
import random
import re
import resource
import struct
import sys
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from bare_problem import BareFull, answer, rewrite_signed
from needs import needs, present
from processes import folders_of, python

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ModelFileError, SnapshotFileWarning

SPARE_ADDRESSES = 1_500 * 2**20
"""Address space of the child beyond what it has when it starts, in bytes."""
MOST_GROWTH = 256 * 2**20
"""Memory that a file may take: those here have less than a megabyte, so this only sees what a file
made up.
"""
POINT = np.array([0.25, 3.0])


# ---------------------------------------------------------------- what is done to a file


def structure(content):
    """Bytes of the headers and of the directory of the archive, and of the descriptions of the
    arrays.
    """
    return [
        place
        for mark, length in (
            (b"PK\x03\x04", 80),
            (b"PK\x01\x02", 80),
            (b"PK\x05\x06", 22),
            (b"\x93NUMPY", 128),
        )
        for found in re.finditer(re.escape(mark), bytes(content))
        for place in range(found.start(), min(found.start() + length, len(content)))
    ]


def flip(content, dice):
    """One bit, or several, anywhere or in the structure."""
    places = structure(content)
    for _ in range(dice.choice([1, 1, dice.randrange(2, 20)])):
        content[dice.choice([dice.choice(places), dice.randrange(len(content))])] ^= (
            1 << dice.randrange(8)
        )


def splice(content, dice):
    """Cut off the end or a piece, put bytes in, or write over a piece."""
    start, size = dice.randrange(len(content)), dice.randrange(1, 200)
    same = min(dice.randrange(1, 2000), len(content) - start)
    written = dice.choice([b"\0", b"\xff", b"("]) * same
    cut, new = dice.choice(
        [(len(content), b""), (size, b""), (0, dice.randbytes(size)), (same, written)]
    )
    content[start : start + cut] = new


def set_field(content, dice):
    """A number of a header of the archive that is not what we write: flags, method, version, sizes,
    offsets.
    """
    local, central = b"PK\x03\x04", b"PK\x01\x02"
    mark = dice.choice([local, central])
    found = dice.choice([match.start() for match in re.finditer(re.escape(mark), bytes(content))])
    offset, form = dice.choice(
        [(4, "H"), (6, "H"), (8, "H"), (18, "I"), (22, "I"), (26, "H"), (28, "H")]
    )
    if mark == central:
        offset += 2
    value = dice.choice(
        [1, 8, 9, 12, 14, 32, 64, 99, 2048, 65535] + [0x7FFFFFFF, 0xFFFFFFF0] * (form == "I")
    )
    struct.pack_into(f"<{form}", content, found + offset, value)


def encrypt(content, dice):
    """The flag of an encrypted member, in its header and in the directory."""
    for mark, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        for match in re.finditer(re.escape(mark), bytes(content)):
            content[match.start() + offset] |= 1


def describe(content, dice):
    """Other text in the place of the description of an array, of the same length."""
    found = dice.choice(list(re.finditer(rb"\{'descr'[^\n]*\n", bytes(content))))
    room = len(found[0]) - 1
    texts = [
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (999999999999, 9), }",
        b"(" * room,
        b"-" * room,
    ]
    texts += [
        b"{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
        b"'''",
        b"[" * 20 + b"]" * 20,
        b"\\",
    ]
    texts += [
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }",
        b"__import__('os')",
        b"lambda: 1",
    ]
    content[found.start() : found.end()] = dice.choice(texts).ljust(room)[:room] + b"\n"


BYTES = [*[flip] * 3, *[splice] * 4, set_field, encrypt, describe]


def other_header(header, dice):
    junk = [
        None,
        "two",
        [],
        {},
        -1,
        10**400,
        float("nan"),
        [[]],
        True,
        1.5,
        {"names": 1},
        ["a"],
        "\0",
    ]
    header[dice.choice(sorted(header))] = dice.choice(junk)


def archive(members, method=zipfile.ZIP_STORED):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method, compresslevel=1) as file:
        for name, content in members.items():
            with file.open(name, "w", force_zip64=True) as member:
                for piece in content:
                    member.write(piece)
    return buffer.getvalue()


def array_bytes(array, **options):
    buffer = io.BytesIO()
    np.save(buffer, array, **options)
    return buffer.getvalue()


def text_header(text):
    return archive({"header.npy": [array_bytes(np.array(text))]})


def description(text):
    """What stands before the numbers of an array."""
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text) + 1) + text + b"\n"


def described(text, held=80):
    """An array of some bytes whose description an interpreter may choke on, or that is much larger
    than what it has.
    """
    return archive({"header.npy": [description(text) + bytes(held)]})


def huge_array(size):
    return described(
        f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({size},), }}".encode(), 800
    )


def bomb(method):
    start = description(b"{'descr': '<f8', 'fortran_order': False, 'shape': (134217728,), }")
    content = bytearray(
        archive({"header.npy": [start, *[bytes(2**20)] * 1024]}, zipfile.ZIP_DEFLATED)
    )
    if method == "stored":  # as if its gigabyte lay in the file as it is
        for mark, offset in ((b"PK\x03\x04", 8), (b"PK\x01\x02", 10)):
            struct.pack_into("<H", content, content.rindex(mark) + offset, 0)
    return content


FOREIGN = {
    "nothing": lambda: b"",
    "no archive": lambda: b"not a model",
    "empty archive": lambda: archive({}),
    "text": lambda: archive({"readme.txt": [b"hello"]}),
    "other arrays": lambda: archive({"a.npy": [array_bytes(np.ones(3))]}),
    "a single array": lambda: array_bytes(np.ones(3)),
    "pickle": lambda: archive({"header.npy": [array_bytes(np.array([{}]), allow_pickle=True)]}),
    "header of a number": lambda: archive({"header.npy": [array_bytes(np.ones(()))]}),
    "impossible characters": lambda: text_header("abcd").replace(
        "abcd".encode("utf-32-le"), b"\xff" * 16
    ),
    "deep lists": lambda: text_header("[" * 200_000),
    "deep objects": lambda: text_header('{"a":' * 100_000),
    "long number": lambda: text_header('{"format": ' + "9" * 10_000 + "}"),
    "no object": lambda: text_header("[1, 2]"),
    "deep description": lambda: described(b"(" * 60_000),
    "signs": lambda: described(b"-" * 60_000 + b"1"),
    "open text": lambda: described(b"{'descr': '''"),
    "huge": lambda: huge_array(10**12),
    "impossible size": lambda: huge_array(10**30),
    "long directory": lambda: archive({f"{k}.npy": [] for k in range(30_000)}),
    "bomb": lambda: bomb("deflated"),
    "bomb that says it is none": lambda: bomb("stored"),
}


def mutants(original, folder, count, seed):
    """Mutated copies of a file, as (what was done, path): foreign ones, then bytes and signed
    headers in turn.
    """
    dice = random.Random(seed)
    content = original.read_bytes()
    # each foreign one has a test of its own too; in a small sample the bombs are seen by their
    # memory
    foreign = (
        list(FOREIGN)
        if count > 2 * len(FOREIGN)
        else ["huge", "deep lists", "bomb that says it is none"]
    )
    for k in range(count):
        path = folder / f"{k}.npz"
        if k < len(foreign):
            name = foreign[k]
            path.write_bytes(FOREIGN[name]())
        elif k == len(foreign):
            name = "hole"
            with open(path, "wb") as file:  # takes no room on the disk
                file.seek(2**40)
                file.write(content)
        elif k % 3:
            change = dice.choice(BYTES)
            name, changed = change.__name__, bytearray(content)
            change(changed, dice)
            path.write_bytes(changed)
        else:
            name = "other header"
            path.write_bytes(content)
            rewrite_signed(path, lambda header, arrays: other_header(header, dice))
        yield f"{name} ({k})", path


# ---------------------------------------------------------------- the child that reads them


def read_model(path):
    """Bytes of answers of a model or of a history, or None if it was refused."""
    try:
        model = hhr.load_model(path)
    except ModelFileError:
        return None
    space = model.parameters
    points = [
        np.array(space.lower) + part * (np.array(space.upper) - space.lower) for part in (0.1, 0.77)
    ]
    with warnings.catch_warnings(action="ignore"):  # no history is what this model was trained on
        if getattr(model, "flow", None) is None:
            answers = [model.solve(point) for point in points]
        else:
            answers = model.march([(0.0, points[0]), (0.1, points[1])]).answers
    parts = [part for answer in answers for part in (answer.displacement(), answer.forces())]
    parts += [answer.plastic_strain() for answer in answers if "gauss" in answer.memory]
    return b"".join(part.tobytes() for part in parts)


def read_snapshot(path):
    """Bytes of a solution, or None if a warning said that it is not taken."""
    store = hhr.SnapshotStore(path.parent / "store", BareFull())
    os.replace(path, store._path(POINT.tolist()))
    with warnings.catch_warnings(record=True, action="always") as caught:
        solution = store.load(POINT)
    if solution is None:
        assert [item.category for item in caught] == [SnapshotFileWarning], caught
        return None
    return solution.unknown.tobytes() + solution.multipliers.tobytes() + solution.active.tobytes()


READERS = {"model": read_model, "snapshot": read_snapshot}


def main(kind, original, *paths):
    """Read the original, then each file, and print a line for each."""
    read = READERS[kind]
    copy = Path(original).with_suffix(".copy")
    copy.write_bytes(Path(original).read_bytes())
    expected = read(copy)
    assert expected is not None
    # memory in kilobytes
    start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + SPARE_ADDRESSES, resource.RLIM_INFINITY))
    for path in paths:
        try:
            found = read(Path(path))
            outcome = (
                "refused" if found is None else "same" if found == expected else "another answer"
            )
        except Exception as error:
            outcome = f"{type(error).__name__}: {str(error)[:200]}"
        growth = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - start)
        print(json.dumps([outcome, growth]), flush=True)


def trial(kind, original, folder, count, seed):
    """Outcomes that are wrong, by what was done to the file, and how many were refused."""
    folder.mkdir()
    cases = list(mutants(original, folder, count, seed))
    folders = [*folders_of(__file__), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(folders)}
    run = python(__file__, kind, original, *(path for _, path in cases), code=None, env=environment)
    lines = [json.loads(line) for line in run.stdout.splitlines() if line.startswith("[")]
    wrong, refused = {}, 0
    for (name, _), (outcome, growth) in zip(cases, lines, strict=False):
        refused += outcome == "refused"
        if outcome not in ("refused", "same") or growth > MOST_GROWTH:
            wrong[name] = f"{outcome}, {growth / 2**20:.0f} MB"
    if len(lines) < len(cases) or run.returncode:
        wrong[cases[len(lines) - 1][0]] = f"ended with {run.returncode}: {run.stderr[-1000:]}"
    return wrong, refused


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Files of three models: with affine amplitudes, with a pressure on a part of a line, and of
    bodies that flow.
    """
    import hertz_half_discs
    import pellet_cladding

    folder = tmp_path_factory.mktemp("models")
    discs = hertz_half_discs.scene(arc_segments=28, flat_segments=7)
    pellet = pellet_cladding.scene(**pellet_cladding.QUICK_MESH)
    for scene, counts, recipe in (
        (discs, [31], hertz_half_discs.THESIS),
        (pellet, [8, 8], hhr.Recipe()),
    ):
        model = hhr.train(scene, counts, held_out=0).build(recipe.as_it_is())
        hhr.save_model(folder / f"{scene.name}.npz", model)
    if present("inelastic"):
        from flowing import flowing_full, flowing_reduction

        hhr.save_model(folder / "z_flowing.npz", flowing_reduction(flowing_full()))
    return sorted(folder.glob("*.npz"))


SEEDS = [pytest.param(20, 1, id="sample"), pytest.param(200, 2, id="full", marks=pytest.mark.slow)]


@pytest.mark.parametrize("count, seed", SEEDS)
@pytest.mark.parametrize(
    "which",
    [0, 1, pytest.param(2, marks=needs("inelastic", "nonmatching"))],
    ids=["discs", "pellet", "flowing"],
)
def test_mutated_models(which, count, seed, models, tmp_path):
    wrong, refused = trial("model", models[which], tmp_path / "mutants", count, seed + 10 * which)
    assert not wrong
    assert refused > 0.5 * count


@pytest.mark.parametrize("count, seed", SEEDS)
def test_mutated_snapshots(count, seed, tmp_path):
    store = hhr.SnapshotStore(tmp_path / "original", BareFull())
    store.save(answer(POINT))
    wrong, refused = trial(
        "snapshot", store._path(POINT.tolist()), tmp_path / "mutants", count, seed
    )
    assert not wrong
    assert refused > 0.5 * count


@pytest.mark.parametrize("name", FOREIGN)
def test_files_of_other_kinds(name, tmp_path):
    """Each by itself, so that a failure says which; memory is looked at by the trials."""
    path = tmp_path / "model.npz"
    path.write_bytes(FOREIGN[name]())
    assert read_model(path) is None


if __name__ == "__main__":
    main(*sys.argv[1:])
