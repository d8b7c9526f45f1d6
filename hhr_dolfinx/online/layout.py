"""What files of models hold, written down once: names, kinds and sizes of their arrays."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hhr_dolfinx.parameters import ParameterSpace

FORMAT, VERSION = "hhr_dolfinx reduced model", 13
CONDENSED, CONDENSED_VERSION = "hhr_dolfinx condensed model", 5
"""Format of files of condensation, exact or interpolated, see ``varying_file``."""
CONDENSED_FLOW, CONDENSED_FLOW_VERSION = "hhr_dolfinx condensed flow model", 5
"""Format of files of condensed flow, see ``condensed_flow_file``."""
LOCAL, LOCAL_VERSION = "hhr_dolfinx local models", 1
"""Format of files of local models, see ``local_file``; their models are of :data:`VERSION`."""
LOCAL_HISTORIES, LOCAL_HISTORIES_VERSION = "hhr_dolfinx local histories", 1
"""Format of files of local models of histories, see ``local_file`` too."""
SLOPES = {"known.margins", "known.slopes"}
"""Of starts along derivatives; files of models whose answers are tabulated do not have them."""
MOTIONS = "reduced.motions"
"""How many modes are rigid motions; files of models without any do not have it."""
ONTO = "response.onto"
"""What a file leaves out of a model that keeps all columns of K^-1 B^T."""
FIXED = {"bound.loads", "bound.lifts"}
"""Of bounds of bodies that are held."""
FLOATING = {"bound.taken", "bound.driving", "bound.work", "bound.cross"}
"""Of bounds of bodies that contact alone holds, in the place of these."""
CONE = "fields.force_snapshots"
"""What a file leaves out of a model whose bound completes forces."""
VALUES = ("amplitudes", "laws", "outputs")
"""Lists of values in the header, see ``values``."""

PACKED = {
    "reduced.gaps": ("C", "m", "terms"),
    "fields.gaps": ("F", "N_lambda", "terms"),
    "fields.lifts": ("csc", "N", "terms"),
    "response.loading": ("csc", "loads", "terms"),
    "flow.lifts": ("csc", "n", "terms"),
    "flow.loads": ("csc", "a", "terms"),
    "flow.contact": ("csr", "a", "m"),
    "flow.eigenstrains": ("csc", "stress inside", "terms"),
    "cubature.given": ("csc", "strains", "terms"),
}
"""Matrices of which only what is not zero is kept: sparse format, or order in memory of a dense one; names of sizes."""

LAYOUT = {
    "reduced.stiffness": ("float", "ell", "ell"),
    "reduced.contact_test": ("float", "m", "ell"),
    "reduced.contact_trial": ("float", "m", "ell"),
    "reduced.loads": ("float", "ell", "terms"),
    "reduced.pairs": ("int", "m"),
    "reduced.motions": ("int",),
    "fields.basis": ("float", "N", "columns"),
    "fields.contact_basis": ("float", "N_lambda", "columns"),
    "fields.A_lambda": ("int", "m"),
    "fields.force_snapshots": ("float", "N_lambda", "force snapshots"),
    "fields.gap_scale": ("float", "N_lambda"),
    "bound.free_slack": ("float", "N_lambda", "terms"),
    "bound.schur": ("float", "N_lambda", "N_lambda"),
    "bound.lower": ("float", "N_lambda", "N_lambda"),
    "bound.basis": ("float", "field rows", "kept columns"),
    "bound.loads": ("float", "load rows", "terms"),
    "bound.lifts": ("float", "lift rows", "terms"),
    "bound.areas": ("float", "N_lambda"),
    "bound.least": ("float", "norms of forces"),
    "bound.taken": ("float", "N_lambda", "motions"),
    "bound.driving": ("float", "motions", "terms"),
    "bound.work": ("float", "terms", "terms"),
    "bound.cross": ("float", "terms", "N_lambda"),
    "response.loaded": ("float", "N", "loads"),
    "response.onto": ("float", "kept columns", "N_lambda"),
    "output_bound.steepness": ("float", "outputs", "norms"),
    "output_bound.free": ("float", "output rows", "terms"),
    "output_bound.pressed": ("float", "output rows", "N_lambda"),
    "output_bound.least": ("float", "outputs"),
    "amplitudes.constant": ("float", "affine terms"),
    "amplitudes.slopes": ("float", "affine terms", "P"),
    "known.points": ("float", "S", "P"),
    "known.active": ("bool", "S", "m"),
    "known.margins": ("float", "S", "m"),
    "known.slopes": ("float", "S", "m", "P"),
    "trained.lower": ("float", "P"),
    "trained.upper": ("float", "P"),
    "paths.slowest": ("float", "P"),
    "paths.fastest": ("float", "P"),
    "paths.steps": ("float", "ends"),
    "paths.rated": ("bool",),
    "paths.imbalance": ("float",),
    "paths.depth": ("float",),
    "paths.stress": ("float",),
    "paths.estimate": ("float",),
    "paths.begun": ("float",),
    "paths.onset": ("float",),
    "flow.gradients": ("float", "cells", "per cell", "components", "dofs of a cell"),
    "flow.weights": ("float", "cells", "per cell"),
    "flow.dofs": ("int", "cells", "dofs of a cell"),
    "flow.cells": ("int", "cells"),
    "flow.modes": ("float", "n", "ell"),
    "flow.inner": ("int", "a"),
    # of each Gauss point the number of its group, so that no point can be in none or in two
    "flow.group": ("int", "cells", "per cell"),
    "flow.young": ("float", "groups"),
    "flow.poisson": ("float", "groups"),
    "cubature.points": ("int", "points"),
    "cubature.per_cell": ("int",),
    "cubature.trial": ("float", "points", "components", "ell"),
    "cubature.test": ("float", "points", "components", "ell"),
    "cubature.loads": ("float", "ell", "terms"),
    "cubature.group": ("int", "points"),
    "cubature.young": ("float", "groups"),
    "cubature.poisson": ("float", "groups"),
    "completion.stress_modes": ("float", "stress values", "stress modes"),
    "completion.stress_fit": ("float", "stress modes", "stress inside"),
    "completion.cumulated_modes": ("float", "gauss points", "strain modes"),
    "completion.cumulated_fit": ("float", "strain modes", "points"),
} | {
    f"{name}.{part}": (kind, f"entries of {name}")
    for name in PACKED
    for part, kind in (("rows", "int"), ("columns", "int"), ("values", "float"))
}
"""Arrays of a file by name: kind, then the names of their sizes; the same name is the same size everywhere.

A field that is added to a part needs one line here.
"""

INDICES = {
    "fields.A_lambda": "N_lambda",
    "flow.dofs": "n",
    "flow.inner": "n",
    "flow.cells": "all cells",
    "flow.group": "groups",
    "cubature.points": "gauss points",
    "cubature.group": "groups",
    **{f"{name}.rows": rows for name, (_, rows, _) in PACKED.items()},
    **{f"{name}.columns": columns for name, (*_, columns) in PACKED.items()},
}
"""Arrays of indices: each must be at least 0 and below the size of this name, since compiled loops do not look."""

PRODUCTS: dict[str, dict[str, tuple[str, ...]]] = {
    "flow": {
        "points": ("cells", "per cell"),
        "stress inside": ("cells", "per cell", "components"),
        "stress values": ("gauss points", "components"),
        "gauss points": ("all cells", "per cell"),
    },
    "cubature": {
        "stress inside": ("points", "components"),
        "stress values": ("gauss points", "components"),
        "gauss points": ("all cells", "per cell"),
    },
}
"""Sizes that are products of others, where all Gauss points of a RID are taken, and where a cubature is."""
CONDENSED_FLOW_LAYOUT = {
    "flow.points": ("int", "points"),
    "flow.parts": ("int", "points"),
    "flow.factors.middle": ("float", "Q"),
    "flow.per_mode": ("float", "modes", "strains"),
    "flow.tested": ("float", "modes", "strains"),
    "flow.per_force": ("float", "m", "strains"),
    "flow.forced": ("float", "strains", "terms"),
    "flow.given": ("float", "strains", "terms"),
    "flow.moved": ("float", "m", "modes"),
    "flow.modal": ("float", "modes", "modes"),
    "flow.coupled": ("float", "modes", "m"),
    "flow.mode_parts": ("int", "modes"),
    "flow.schur": ("float", "Q", "m", "m"),
    "flow.pressed": ("float", "Q", "m", "terms"),
    "flow.gaps": ("float", "m", "terms"),
    "fields.amplitudes.constant": ("float", "affine terms"),
    "fields.amplitudes.slopes": ("float", "affine terms", "P"),
    "fields.factors.middle": ("float", "Q"),
    "fields.parts": ("int", "N"),
    "fields.basis": ("float", "N", "modes"),
    "fields.per_force": ("float", "N", "m"),
    "fields.forced": ("float", "N", "terms"),
    "fields.given": ("float", "N", "terms"),
    "fields.flow.points": ("int", "points"),
    "fields.flow.flowed": ("int", "flowed points"),
    "fields.flow.plastic.modes": ("float", "flowed strains", "plastic modes"),
    "fields.flow.plastic.fit": ("float", "plastic modes", "strains"),
    "fields.flow.cumulated.modes": ("float", "flowed points", "strain modes"),
    "fields.flow.cumulated.fit": ("float", "strain modes", "points"),
    "fields.flow.moved": ("float", "N", "plastic modes"),
    "fields.flow.strain.gradients": ("float", "cells", "per cell", "components", "dofs of a cell"),
    "fields.flow.strain.weights": ("float", "cells", "per cell"),
    "fields.flow.strain.dofs": ("int", "cells", "dofs of a cell"),
    "fields.flow.unstressed.rows": ("int", "strains without stress"),
    "fields.flow.unstressed.columns": ("int", "strains without stress"),
    "fields.flow.unstressed.values": ("float", "strains without stress"),
    "fields.flow.moduli": ("float", "gauss points", "moduli"),
    "trained.parameters.lower": ("float", "P"),
    "trained.parameters.upper": ("float", "P"),
    "trained.slowest": ("float", "P"),
    "trained.fastest": ("float", "P"),
}
"""Arrays of a model of condensed flow by their paths in its tree, as in :data:`LAYOUT`."""

CONDENSED_FLOW_INDICES = {
    "flow.points": "gauss points",
    "flow.parts": "Q",
    "flow.mode_parts": "Q",
    "fields.parts": "Q",
    "fields.flow.flowed": "gauss points",
    "fields.flow.strain.dofs": "N",
}
"""Arrays of indices among them, as in :data:`INDICES`."""

CONDENSED_FLOW_GIVEN = {"flow.given": "flow.forced", "fields.given": "fields.forced"}
"""Arrays among them of which only what is not zero is kept, each with another one of its shape."""

CHOICE_LAYOUT = {
    "choice.axis": ("int", "nodes"),
    "choice.cut": ("float", "nodes"),
    "choice.low": ("int", "nodes"),
    "choice.high": ("int", "nodes"),
    "choice.label": ("int", "nodes"),
    "choice.reach": ("float", "P"),
}
"""Arrays of the choice between local models, as in :data:`LAYOUT`."""

TYPES = {"float": np.float64, "int": np.int64, "bool": np.bool_}
MAY_BE_NONE = {"force snapshots", "stress modes", "strain modes", "output rows", "lift rows", "loads", "kept columns"}
MAY_BE_NONE |= {f"entries of {name}" for name in PACKED}


class Content(NamedTuple):
    """What a file holds, checked: the box, arrays of the table, sizes by name, values that are a kind and numbers, and
    why there is no bound where there is none.
    """

    space: ParameterSpace
    dimension: int
    arrays: dict[str, np.ndarray]
    sizes: dict[str, int]
    amplitudes: list[Any]
    laws: list[Any]
    outputs: list[Any]
    unbounded: str
