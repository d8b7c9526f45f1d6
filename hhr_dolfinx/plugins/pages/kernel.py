"""The kernel that solves contact problems without Python: its C sources, and what is compiled of them for pages.

Headers and pages have one kernel. In a header its sizes are constants; on a page they are variables, so that a few
kernels in WebAssembly, compiled once, answer for all models.
"""

from __future__ import annotations

import hashlib
import importlib.util
import subprocess
import sys
import tempfile
from importlib import resources
from pathlib import Path
from typing import Any, Protocol

from hhr_dolfinx.errors import MissingPackageError, NotOfferedError

PARTS = ("floating", "friction", "flow")
"""Capabilities that a kernel has or has not; each is a key of the tree of a model."""


class KernelOfLaw(Protocol):
    """Sources of a law of interfaces."""

    key: str  # part that the law is
    header: Path  # its text in C


def kernel_parts(tree: dict[str, Any]) -> list[str]:
    """Parts of the kernel that a model needs."""
    return [part for part in PARTS if tree[part]]


def kernel_text(parts: list[str], law: KernelOfLaw | None) -> str:
    """Text of the kernel with some parts, without its data."""
    texts = {part: kernel_file(f"{part}.h") for part in ("floating", "springs")}
    texts["flow"] = kernel_file("programs.h") + kernel_file("flow.h")
    if law is not None:
        texts[law.key] = law.header.read_text("utf-8")
    text = kernel_file("kernel.h")
    for part in (*PARTS, "springs"):
        needed = ("floating" if part == "springs" else part) in parts
        text = text.replace(f"/*{part.upper()}*/", texts[part] if needed else "")
    return text


def kernel_file(name: str) -> str:
    """Text of a C file of the kernel."""
    return (resources.files(__package__) / "c" / name).read_text(encoding="utf-8")


FREESTANDING = ("math.h", "stdlib.h", "string.h")
"""Headers of C that a compiler for WebAssembly lacks."""
FLAGS = (
    "--target=wasm32-freestanding",
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
MARK = b"sources"
"""Name of the section of a kernel that has the digest of its sources."""
_DEFINED = {"friction": "MODEL_RUBS", "flow": "MODEL_FLOWS", "floating": "MODEL_FLOATS"}


def page_sources(parts: list[str], law: KernelOfLaw | None) -> dict[str, str]:
    """Sources of a kernel for pages by their names, of which ``page.c`` is compiled."""
    found = {f"freestanding/{name}": kernel_file(f"freestanding/{name}") for name in FREESTANDING}
    flags = "".join(f"#define {name} {int(part in parts)}\n" for part, name in _DEFINED.items())
    found["kernel.h"] = kernel_text(parts, law).replace("/*DATA*/", kernel_file("sizes.h"))
    found["page.c"] = flags + kernel_file("page.c")
    return found


def digest_of(sources: dict[str, str]) -> bytes:
    """SHA-256 of the sources of a kernel and of the options of its compiler."""
    text = "\0".join([*FLAGS, *(f"{name}\0{sources[name]}" for name in sorted(sources))])
    return hashlib.sha256(text.encode()).digest()


def compiled(sources: dict[str, str]) -> bytes:
    """A kernel for pages, compiled by clang of the package ``ziglang``, and marked by the digest of its sources.

    Raises:
        MissingPackageError: if that package is not installed.
        NotOfferedError: if the sources are not those of a kernel.
    """
    if importlib.util.find_spec("ziglang") is None:
        raise MissingPackageError("a kernel for pages is compiled by the package ziglang: pip install ziglang")
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
        return (folder / "kernel.wasm").read_bytes() + _section(MARK, digest_of(sources))


def _section(name: bytes, content: bytes) -> bytes:
    """Custom section of WebAssembly, which browsers skip; name and content together have less than 127 bytes."""
    return bytes([0, 1 + len(name) + len(content), len(name)]) + name + content


def kernel_path(parts: list[str], law: KernelOfLaw | None) -> Path:
    """File of the compiled kernel with some parts: of this plug-in, or beside the header of the law."""
    folder = Path(__file__).with_name("c") if law is None else law.header.parent
    first = "contact" if law is None else law.key
    return folder / ("_".join([first, *(part for part in parts if part != first)]) + ".wasm")
