"""Compile the kernels of pages again, after a change of their C sources: needs the package
ziglang.
"""

from __future__ import annotations

import itertools

from hhr_dolfinx import registry
from hhr_dolfinx.plugins.pages.kernel import compiled, kernel_path, page_sources
from hhr_dolfinx.plugins.pages.laws import Laws

LAWS = ("friction",)
"""Plug-ins of laws of interfaces that bring kernels."""


def main() -> None:
    """Compile all of them."""
    facets = [
        registry.facet(name, "page", "a kernel") for name in LAWS if name in registry.installed()
    ]
    for law, part in itertools.product(
        [None, *facets], ([], ["floating"], ["flow"], ["floating", "flow"])
    ):
        parts = [*part, *([] if law is None else [law.key])]
        path = kernel_path(parts, Laws(law, ()))
        path.write_bytes(found := compiled(page_sources(parts, Laws(law, ()))))
        print(path.name, len(found))
    if "contact_heat" in registry.installed():
        from hhr_dolfinx.plugins.contact_heat.on_page import HEAT_KERNEL, heat_sources

        HEAT_KERNEL.write_bytes(found := compiled(heat_sources()))
        print(HEAT_KERNEL.name, len(found))


if __name__ == "__main__":
    main()
