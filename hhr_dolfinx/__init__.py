"""Hybrid hyper-reduction of parametric contact problems with Lagrange multipliers.

The public names below are loaded when they are first used, so that a reduced model read from
a file (``load_model``) needs neither DOLFINx nor gmsh.
"""

from importlib import import_module

from hhr_dolfinx import compat as _compat  # noqa: F401  (before any import of dolfinx, mpi4py or petsc4py)

_MODULES = {
    "version": ["__version__"],
    "parameters": ["Amplitude", "ParameterSpace"],
    "loads": ["PartialPressure", "Pressure", "Term", "Traction"],
    "scene": ["Body", "Displacement", "Opening", "Scene"],
    "pairings.node_to_node": ["NodeToNode"],
    "pairings.obstacle": ["Obstacle"],
    "pairings.node_to_surface": ["NodeToSurface", "DoublePass"],
    "pairings.mortar": ["Mortar"],
    "materials.laws": ["Plasticity", "Norton"],
    "models.answer": ["Answer", "History"],
    "models.path": ["MarchSettings"],
    "models.reduced": ["ReducedModel"],
    "certify.trust": ["TrustLimits"],
    "full_order.full": ["FullOrderModel"],
    "snapshots.records": ["SnapshotSet", "compute_histories", "compute_snapshots", "spread_snapshots"],
    "snapshots.store": ["SnapshotStore"],
    "reduction.recipe": [
        "Recipe", "Pod", "Deim", "ForceDeim", "StressDeim", "FlowDeim", "LoadNodes", "Zone", "Rid", "Enrich", "Tangents",
    ],
    "reduction.build": ["build"],
    "baselines.condensation": ["exact_condensation"],
    "online.model_file": ["load_model", "save_model"],
    "online.batch": ["answer_points", "answer_table", "read_points", "write_answers"],
    "study.training": ["train"],
    "study.study": ["Rival", "StudySettings", "run_study", "study_scene"],
    "study.view": ["View"],
}
_PUBLIC = {name: module for module, names in _MODULES.items() for name in names}

__all__ = list(_PUBLIC)


def __getattr__(name):
    """Import a public name from its module on first use."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'hhr_dolfinx' has no attribute '{name}'")
    return getattr(import_module(f"hhr_dolfinx.{_PUBLIC[name]}"), name)


def __dir__():
    """List the public names."""
    return __all__
