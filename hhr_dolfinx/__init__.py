"""Hybrid hyper-reduction of parametric contact problems with Lagrange multipliers.

The public names below are loaded when they are first used, so that a reduced model read from
a file (``load_model``) needs neither DOLFINx nor gmsh.
"""

from importlib import import_module

from hhr_dolfinx import compat as _compat  # noqa: F401  (before any import of dolfinx, mpi4py or petsc4py)

_PUBLIC = {
    "Amplitude": "parameters",
    "ParameterSpace": "parameters",
    "Body": "scene",
    "Displacement": "scene",
    "NodeToNode": "pairings.node_to_node",
    "Obstacle": "pairings.obstacle",
    "NodeToSurface": "pairings.node_to_surface",
    "DoublePass": "pairings.node_to_surface",
    "Mortar": "pairings.mortar",
    "PartialPressure": "scene",
    "Pressure": "scene",
    "Scene": "scene",
    "Traction": "scene",
    "Opening": "scene",
    "Plasticity": "forms.plasticity",
    "Norton": "forms.plasticity",
    "PlasticFullOrder": "plastic_full_order",
    "PlasticSettings": "plastic_reduced",
    "build_plastic_reduction": "plastic_reduced",
    "MarchSettings": "quasi_static",
    "march": "quasi_static",
    "FullOrderModel": "full_order",
    "compute_snapshots": "snapshots",
    "spread_snapshots": "snapshots",
    "SnapshotStore": "snapshot_store",
    "read_points": "batch",
    "answer_rows": "batch",
    "write_answers": "batch",
    "SnapshotSet": "snapshots",
    "ReductionSettings": "offline",
    "build_reduced_model": "offline",
    "ReducedModel": "reduced",
    "load_model": "model_file",
    "save_model": "model_file",
    "StudySettings": "study",
    "Rival": "study",
    "run_study": "study",
    "train": "study",
    "make_report": "report",
    "print_report": "report",
    "write_report": "report",
}

__all__ = list(_PUBLIC)


def __getattr__(name):
    """Import a public name from its module on first use."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'hhr_dolfinx' has no attribute '{name}'")
    return getattr(import_module(f"hhr_dolfinx.{_PUBLIC[name]}"), name)


def __dir__():
    """List the public names."""
    return __all__
