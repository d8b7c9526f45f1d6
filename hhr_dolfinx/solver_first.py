"""Import ``dolfinx_solver`` before the first import of dolfinx, mpi4py, petsc4py or slepc4py in a
process.

The wheel ``dolfinx-solver-real`` has its MPI in its folder: ``from dolfinx import mesh`` as the
first line of a program fails with "libmpi.so.12: cannot open shared object file". This package
ensures the order once it is imported. ``python -m hhr_dolfinx.solver_first`` ensures it in an
environment for every program, by a ``.pth`` file and a copy of this file. Without the wheel, as
with conda and apt, nothing happens. Only modules of Python are imported, since every start of
Python runs this.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

COPY = "hhr_dolfinx_solver_first"
"""Name of the copy in an environment, and of its ``.pth`` file."""


class _Loaded:
    """Loader of a module that was already loaded during the search for it.

    The import system would load a module with a specification a second time, so that the module has
    none meanwhile.
    """

    def __init__(self, module: ModuleType):
        self._module = module
        self._own = module.__spec__
        module.__spec__ = None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """The module."""
        return self._module

    def exec_module(self, module: ModuleType) -> None:
        """Restore the specification; the module was executed before."""
        module.__spec__ = self._own


class SolverFirst:
    """Import hook that imports ``dolfinx_solver`` before the first of the packages that need it.

    It does not import it earlier: a model from a file needs none of these, and starting MPI takes
    longer than reading the model.
    """

    NAMES = frozenset({"dolfinx", "mpi4py", "petsc4py", "slepc4py"})

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """None, so that other finders continue, or the module if ``dolfinx_solver`` has loaded
        it.

        Args:
            fullname: name of the module.
            path: path of its package.
            target: module that is reloaded.
        """
        if fullname not in self.NAMES or importlib.util.find_spec("dolfinx_solver") is None:
            return None
        # returns at once for imports of dolfinx_solver itself
        importlib.import_module("dolfinx_solver")
        module = sys.modules.get(fullname)
        if module is None:
            return None
        loader = _Loaded(module)
        return ModuleSpec(fullname, loader, origin=module.__file__)  # type: ignore[arg-type]


def install() -> None:
    """Ensure the order in this process."""
    if not any(type(finder).__name__ == SolverFirst.__name__ for finder in sys.meta_path):
        sys.meta_path.insert(0, SolverFirst())


def install_for_all(folder: Path) -> Path:
    """Ensure the order in every start of the Python whose packages are in a folder.

    Return the ``.pth`` file.
    """
    (folder / f"{COPY}.py").write_text(Path(__file__).read_text(encoding="utf-8"), encoding="utf-8")
    start = folder / f"{COPY}.pth"
    start.write_text(f"import {COPY}; {COPY}.install()\n", encoding="utf-8")
    return start


if __name__ == "__main__":
    import sysconfig

    print(
        f"{install_for_all(Path(sysconfig.get_path('purelib')))}: dolfinx may be imported first "
        "from now on"
    )
