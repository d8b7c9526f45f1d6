"""The kernel that solves contact problems without Python: its C sources, and what is compiled of
them for pages.

Headers and pages have one kernel. In a header its sizes are constants; on a page they are
variables, so that a few kernels in WebAssembly, compiled once, answer for all models.
"""

from __future__ import annotations

import hashlib
import importlib.util
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

from hhr_dolfinx.errors import MissingPackageError, NotOfferedError
from hhr_dolfinx.plugins.pages.laws import Laws

KERNEL_PARTS = ("floating", "friction", "flow", "ranges")
"""Capabilities that a kernel has or has not; each is a key of the tree of a model."""
FLAGS_OF_PARTS = {
    "friction": "RUBS",
    "flow": "FLOWS",
    "floating": "FLOATS",
    "ranges": "RANGED",
    "memory": "REMEMBERS",
}
"""Flags of the parts; with ``memory`` a law of the ranges remembers."""


def kernel_parts(tree: dict[str, Any]) -> list[str]:
    """Parts of the kernel that a model needs."""
    names = [name for name in KERNEL_PARTS if tree[name]]
    return [*names, "memory"] if tree["ranges"] and tree["ranges"]["remembers"] else names


def kernel_text(parts: list[str], laws: Laws) -> str:
    """Text of the kernel with some parts, without its data.

    Args:
        parts: names of optional parts of the kernel.
        laws: contact laws in C.
    """
    texts = {name: kernel_file(f"{name}.h") for name in ("floating", "springs", "ranges")}
    texts["flow"] = kernel_file("programs.h") + kernel_file("flow.h")
    text = kernel_file("kernel.h")
    range_code = ""
    if laws.part is not None:
        texts[laws.part.key] = laws.part.header.read_text("utf-8")
        range_code = laws.part.range_header.read_text("utf-8")
    for name in (*KERNEL_PARTS, "springs"):
        needed = ("floating" if name == "springs" else name) in parts
        text = text.replace(f"/*{name.upper()}*/", texts[name] if needed else "")
    return text.replace("/*LAWS*/", _laws(laws)).replace("/*RUBBING*/", range_code)


def _laws(laws: Laws) -> str:
    """Functions of laws of ranges, and the calls of each by its number."""
    declared = "const model_own *own"
    calls = {
        "shift": ("double", declared, "own", "0"),
        "projection": (
            "double",
            f"{declared}, double y, double c, double *slope",
            "own, y, c, slope",
            "(*slope = NAN)",
        ),
        "after": (
            "void",
            f"{declared}, double force, double slack, int active, double *memory",
            "own, force, slack, active, memory",
            "",
        ),
    }
    text = "#define MODEL_BENEATH\n" if laws.beneath else ""
    text += "\n".join(law.text for law in laws.ranges)
    for name, (result, arguments, passed, nothing) in calls.items():
        words = ["law", *(argument.split()[-1].lstrip("*") for argument in arguments.split(","))]
        text += f"\nstatic inline {result} model_law_{name}(int law, {arguments}) {{\n    "
        text += ", ".join(f"(void){word}" for word in words) + ";\n"
        for number, law in enumerate(laws.ranges, start=1):
            if name == "projection" or law.memory:
                call = f"model_{law.name}_{name}({passed});"
                text += f"    if (law == {number}) {'return ' if nothing else ''}{call}\n"
        text += (f"    return {nothing};\n" if nothing else "") + "}\n"
    return text


def prefixed(text: str, names: Mapping[str, str]) -> str:
    """Code whose names begin otherwise; quoted texts are names of the scene, and stay.

    Args:
        text: the code.
        names: beginnings before an underscore, ``model`` and ``MODEL`` for instance by ``model``.
    """
    prefixes = {f"{old}_": f"{new}_" for old, new in names.items()}
    prefixes |= {f"{old}_".upper(): f"{new}_".upper() for old, new in names.items()}
    beginnings = "|".join(prefixes)
    return re.sub(
        rf'"[^"\n]*"|\b(?:{beginnings})', lambda found: prefixes.get(found[0], found[0]), text
    )


def kernel_file(name: str) -> str:
    """Text of a C file of the kernel."""
    return (resources.files(__package__) / "c" / name).read_text(encoding="utf-8")


FREESTANDING = ("math.h", "stdlib.h", "string.h")
"""Headers of C that a compiler for WebAssembly lacks."""
FLAGS = (
    "-target",
    "wasm32-freestanding",
    *(
        "-std=c99",
        "-Os",
        "-ffp-contract=off",
        "-fno-builtin",
        "-fno-inline",
        "-mbulk-memory",
        "-nostdlib",
        "-fvisibility=hidden",
    ),
    *("-Wl,--no-entry", "-Wl,--strip-all", "-Wl,-z,stack-size=1048576"),
)
"""Options of clang for a kernel of pages."""
SOURCES_SECTION = b"sources"
"""Name of the section of a kernel that has the digest of its sources."""


def page_sources(parts: list[str], laws: Laws, added: str = "") -> dict[str, str]:
    """Sources of a kernel for pages by their names, of which ``page.c`` is compiled.

    Args:
        parts: names of optional parts of the kernel.
        laws: contact laws in C.
        added: C of a plug-in that solves more than contact with this kernel.
    """
    sources = {f"freestanding/{name}": kernel_file(f"freestanding/{name}") for name in FREESTANDING}
    flags = "".join(
        f"#define MODEL_{name} {int(name_of_flag in parts)}\n"
        for name_of_flag, name in FLAGS_OF_PARTS.items()
    )
    sources["kernel.h"] = kernel_text(parts, laws).replace("/*DATA*/", kernel_file("sizes.h"))
    sources["page.c"] = flags + kernel_file("page.c") + added
    return sources


def digest_of(sources: dict[str, str]) -> bytes:
    """SHA-256 of the sources of a kernel and of the options of its compiler."""
    text = "\0".join([*FLAGS, *(f"{name}\0{sources[name]}" for name in sorted(sources))])
    return hashlib.sha256(text.encode()).digest()


def compiled(sources: dict[str, str]) -> bytes:
    """A kernel for pages, compiled by clang of the package ``ziglang``, and marked by the digest of
    its sources.

    Raises:
        MissingPackageError: if that package is not installed.
        NotOfferedError: if the sources are not those of a kernel.
    """
    if importlib.util.find_spec("ziglang") is None:
        raise MissingPackageError(
            "a kernel for pages is compiled by the package ziglang: pip install ziglang"
        )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "freestanding").mkdir()
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        words = [
            sys.executable,
            "-m",
            "ziglang",
            "cc",
            *FLAGS,
            "-isystem",
            "freestanding",
            "-o",
            "kernel.wasm",
            "page.c",
        ]
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True)
        if done.returncode:
            raise NotOfferedError(f"the kernel of this law is not compiled: {done.stderr[:1000]}")
        return (folder / "kernel.wasm").read_bytes() + _section(SOURCES_SECTION, digest_of(sources))


def _section(name: bytes, content: bytes) -> bytes:
    """Custom section of WebAssembly, which browsers skip.

    Name and content together have less than 127 bytes.
    """
    return bytes([0, 1 + len(name) + len(content), len(name)]) + name + content


def kernel_path(parts: list[str], laws: Laws) -> Path:
    """File of the compiled kernel with some parts.

    It is one of this plug-in, or lies beside the header of a law.

    Args:
        parts: names of optional parts of the kernel.
        laws: contact laws in C.
    """
    folder = Path(__file__).with_name("c") if laws.part is None else laws.part.header.parent
    first = "contact" if laws.part is None else laws.part.key
    return folder / ("_".join([first, *(name for name in parts if name != first)]) + ".wasm")


def kernel_of(parts: list[str], laws: Laws) -> bytes:
    """The compiled kernel with some parts, which is compiled here for laws of users."""
    return (
        _compiled(tuple(parts), laws)
        if "ranges" in parts
        else kernel_path(parts, laws).read_bytes()
    )


@lru_cache(maxsize=8)
def _compiled(parts: tuple[str, ...], laws: Laws) -> bytes:
    return compiled(page_sources([*parts], laws))
