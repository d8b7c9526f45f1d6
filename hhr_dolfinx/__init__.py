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
    "PlasticFullOrder": "full_order.plastic",
    "PlasticSettings": "reduction.plastic",
    "build_plastic_reduction": "reduction.plastic",
    "MarchSettings": "flow.quasi_static",
    "march": "flow.quasi_static",
    "FullOrderModel": "full_order.elastic",
    "compute_snapshots": "snapshots.solutions",
    "spread_snapshots": "snapshots.solutions",
    "SnapshotStore": "snapshots.store",
    "read_points": "online.batch",
    "answer_rows": "online.batch",
    "write_answers": "online.batch",
    "SnapshotSet": "snapshots.solutions",
    "ReductionSettings": "reduction.offline",
    "build_reduced_model": "reduction.offline",
    "ReducedModel": "reduction.reduced",
    "load_model": "online.model_file",
    "save_model": "online.model_file",
    "StudySettings": "study.study",
    "Rival": "study.study",
    "run_study": "study.study",
    "train": "study.study",
    "make_report": "study.report",
    "print_report": "study.report",
    "write_report": "study.report",
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
