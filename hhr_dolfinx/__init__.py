"""Hybrid hyper-reduction of parametric contact problems with Lagrange multipliers.

Public names are loaded when they are first used, so that a reduced model read from a file
(``load_model``) needs neither DOLFINx nor gmsh. Those of plug-ins stand in their manifests.
``__init__.pyi`` has all of them for type checkers, and is written by ``scripts/stubs.py``.
"""

import importlib
import importlib.util
import logging

import lazy_loader

from hhr_dolfinx import compat as _compat

# silent unless a user configures logging
logging.getLogger(__name__).addHandler(logging.NullHandler())

PUBLIC = {
    "amplitudes": "Amplitude",
    "body": "Body",
    "certify.trust": "TrustLimits",
    "errors": "HHRError",
    "full_order.full": "FullOrderModel",
    "geometries.mesh_file": "MeshFile",
    "loads": "PartialPressure Pressure Term Traction",
    "models.answer": "Answer History",
    "models.histories.equilibrium": "MarchSettings",
    "models.reduced": "ReducedModel",
    "online.model_file": "load_model save_model",
    "outputs": (
        "ContactForce ContactMoment ContactWidth DisplacementAt GapAt LargestPressure LinearForm "
        "LostContact"
    ),
    "pairings.node_to_node": "NodeToNode",
    "pairings.obstacle": "Obstacle",
    "parameters": "ParameterSpace",
    "reduction.build": "build",
    "reduction.exact": "exact_condensation",
    "reduction.recipe": "Deim Enrich ForceDeim LoadNodes Pod Recipe Rid Zone",
    "sampling": "LatinHypercube Sobol",
    "scene": "Displacement Opening Scene",
    "snapshots.records": "SnapshotSet compute_snapshots spread_snapshots",
    "snapshots.store": "SnapshotStore",
    "study.condensing": "condense",
    "study.training.train": "train",
    "units": "Units",
    "version": "__version__",
}
"""Public names of the core by module."""
_of_core, _, _names = lazy_loader.attach(
    __name__, submod_attrs={at: names.split() for at, names in PUBLIC.items()}
)


def _of_plugins() -> dict[str, str]:
    return importlib.import_module("hhr_dolfinx.registry").named("public")


def __dir__() -> list[str]:
    return sorted({*_names, *_of_plugins()})


def __getattr__(name: str) -> object:
    """Public name, imported at first use.

    If DOLFINx is missing, the error explains how to install it.
    """
    try:
        if name == "__all__":
            return __dir__()
        # a scan of plug-ins takes milliseconds, and asking for a sub-module leads here first
        if name in _names or name.startswith("_") or importlib.util.find_spec(f"{__name__}.{name}"):
            return _of_core(name)
        if name not in (import_paths := _of_plugins()):
            remedy = importlib.import_module(f"{__name__}.registry").remedy("public", name)
            raise AttributeError(
                f"module '{__name__}' has no '{name}'"
                f"{remedy or ', and no installed plug-in adds it'}"
            )
        module, _, attribute = import_paths[name].partition(":")
        globals()[name] = value = getattr(importlib.import_module(module), attribute)
        return value
    except ModuleNotFoundError as error:
        raise _compat.explained(error) from error
