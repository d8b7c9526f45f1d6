"""Compile the kernels of pages again, after a change of their C sources: needs the package ziglang."""

from __future__ import annotations

import itertools

from hhr_dolfinx import registry
from hhr_dolfinx.plugins.pages.kernel import compiled, kernel_path, page_sources

LAWS = ("friction",)
"""Plug-ins of laws of interfaces that bring kernels."""


def main() -> None:
    """Compile all of them."""
    laws = [registry.facet(name, "page", "a kernel") for name in LAWS if name in registry.installed()]
    for law, part in itertools.product([None, *laws], ([], ["floating"], ["flow"])):
        parts = [*part, *([] if law is None else [law.key])]
        kernel_path(parts, law).write_bytes(found := compiled(page_sources(parts, law)))
        print(kernel_path(parts, law).name, len(found))


if __name__ == "__main__":
    main()
