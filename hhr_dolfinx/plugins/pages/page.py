"""One HTML file that solves like a model: by double click, from mail, without Python and without a
network.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html import escape
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.files import replacing
from hhr_dolfinx.models.estimates import relative_errors
from hhr_dolfinx.plugins.pages.added import AddedToPage, OwnPage
from hhr_dolfinx.plugins.pages.arrays import check_model, contact_tree, drawn, flows, packed
from hhr_dolfinx.plugins.pages.packing import Json, Packed
from hhr_dolfinx.plugins.pages.scenery import Scenery, compliance_of, thinned
from hhr_dolfinx.timing import today
from hhr_dolfinx.version import __version__

if TYPE_CHECKING:
    from hhr_dolfinx.models.model import KeptModel

MOST_PAGE_BYTES = 3_000_000
"""Largest size of a page: the limit of many mail servers."""
SAME_COMPLIANCE = 0.01
"""Relative difference of S up to which a model and a scenery are of one scene: S may be
interpolated.
"""
NOTHING = 1e-10
"""Part of S that counts as round-off there."""
DRAWN_NODES = 12_000
"""Most nodes of the drawn mesh."""
SCRIPTS = 150_000
"""Most bytes of a page without its arrays."""
_SCRIPTS = "model bound steps flow path drawing plots field view".split()
PAGE_FILES = ("page.css", *(f"{name}.js" for name in _SCRIPTS))
"""Files that replace their names in ``page.html``."""
_UNREAD = re.compile(r"^[ \t]*/\*.*?\*/\s*\n|^[ \t]+", re.DOTALL | re.MULTILINE)
"""Comments on lines of their own and indentation: 8 kB of the scripts, which no page needs."""
PAGE_ERROR_POINTS = 100
"""Random points at which the error shown on a page is estimated."""


def write_model_page(
    path: str | Path, model: KeptModel | OwnPage, scenery: Scenery | None = None
) -> Path:
    """Write a page of a condensed model.

    Args:
        path: of the page, ``.html``.
        model: of ``hhr.condense``, ``hhr.train`` or a file: elastic, frictional, or condensed
            inelastic; or of ``hhr.condense_heat``.
        scenery: mesh to draw, see :func:`hhr_dolfinx.plugins.pages.scenery_of.scenery_of`; None
            takes that of the full model that a model was made of in this process.

    Returns:
        The path.

    Raises:
        NotOfferedError: for any other model, one of another scene, or one that is too large for a
            page.
        FileError: if the file cannot be written.
    """
    added = model.on_page() if isinstance(model, OwnPage) else None
    contact = model if added is None else added.contact
    check_for_page(model)
    scenery = _own_scenery(contact) if scenery is None else scenery
    check_alike(contact, scenery)
    text = page_text(contact, scenery, added)
    _check_size(len(text.encode()), contact)
    with replacing(path, text=True) as file:
        file.write(text)
    return Path(path)


def _own_scenery(model: Any) -> Scenery:
    """Scenery of the full model that a model knows.

    Raises:
        NotOfferedError: for a model from a file, which knows none.
    """
    from hhr_dolfinx.plugins.pages.scenery_of import scenery_of

    if (full := getattr(model.fields, "full", None)) is None:
        raise NotOfferedError(
            "this model comes from a file, and knows no mesh to draw: give its scenery, "
            "hhr.scenery_of(hhr.FullOrderModel(scene))"
        )
    return scenery_of(full)


def check_alike(model: Any, scenery: Scenery) -> None:
    """Refuse a scenery of another scene or mesh than a model that keeps all contact conditions.

    Args:
        model: condensed model.
        scenery: drawn mesh and contact of the scene.

    Raises:
        NotOfferedError: for another number of conditions or dofs, or other contact.
    """
    if len(scenery.areas) != model.conditions:
        raise NotOfferedError(
            f"the scenery is of {len(scenery.areas)} contact conditions and the model of "
            f"{model.conditions}: they are of two scenes or meshes"
        )
    dofs = len(model.fields.basis) if flows(model) else model.fields.lifts.shape[0]
    if scenery.nodes.max(initial=0) * model.dimension >= dofs or (
        scenery.strains and scenery.strains.dofs != dofs
    ):
        raise NotOfferedError(
            f"the scenery is of another mesh than the model, which has {dofs} dofs"
        )
    middle = model.parameters.middle
    equations = model.equilibrium.at(middle) if flows(model) else model.contacts()(middle)
    loose = model.fields.loose if flows(model) else None
    compliance = (
        equations.schur.sum(axis=1)
        if loose is None
        else compliance_of(equations.schur.__matmul__, loose.taken)
    )
    nothing = (
        0.0 if loose is None else NOTHING * np.linalg.norm(equations.schur)
    )  # motions may leave no other forces
    if (
        not np.linalg.norm(compliance - scenery.compliance)
        <= SAME_COMPLIANCE * np.linalg.norm(compliance) + nothing
    ):
        raise NotOfferedError(
            "the scenery is not of the scene of this model: its contact is stiffer or softer"
        )


def check_for_page(model: Any) -> None:
    """Refuse a model that does not fit on a page, before its scenery, bounds and pictures are
    computed.
    """
    added = model.on_page() if isinstance(model, OwnPage) else None
    contact = model if added is None else added.contact
    check_model(contact)
    arrays = Packed()
    contact_tree(contact, arrays)
    _check_size(arrays.size + (0 if added is None else added.size), contact)


def _check_size(count: int, model: Any) -> None:
    if count > MOST_PAGE_BYTES:
        size = f"{model.conditions} contact conditions"
        if flows(model):
            size += (
                f", {len(model.flow.per_mode)} modes and {model.flow.points.size} points at which "
                "laws are evaluated"
            )
        raise NotOfferedError(
            f"a page of {count / 1e6:.1f} MB or more exceeds the "
            f"{MOST_PAGE_BYTES / 1e6:g} MB that go "
            f"by mail: {size} are too many. Take a coarser mesh for the page"
            + (
                ", or a model with fewer modes: a larger error, or fewer paths"
                if flows(model)
                else ""
            )
        )


def page_text(model: Any, scenery: Scenery, added: AddedToPage | None = None) -> str:
    """Text of the page.

    Args:
        model: condensed model.
        scenery: drawn mesh and contact of the scene.
        added: what a plug-in adds to the page of this model.
    """
    if flows(model):
        from hhr_dolfinx.plugins.pages.flow_stress import cells_of

        scenery = replace(scenery, owners=cells_of(model, scenery))
    strained = 0 if scenery.strains is None else len(scenery.strains.bodies)
    if scenery.owners is not None:
        strained = int(np.unique(scenery.owners).size)
    scenery = thinned(scenery, DRAWN_NODES)
    of_scenery, placed = drawn(scenery)
    tree, arrays = packed(
        model,
        scenery,
        MOST_PAGE_BYTES - SCRIPTS - sum(len(array["data"]) for array in placed.values()),
        added,
    )
    tree |= {"scenery": of_scenery, "strained": strained}
    arrays |= placed
    tree["error"] = error_of(model)
    tree["made"] = f"{today()}, hhr_dolfinx {__version__}"
    data = json.dumps(
        {"tree": tree, "arrays": arrays}, separators=(",", ":"), allow_nan=False
    ).replace("<", "\\u003c")
    needed = {"flow.js": flows(model), "steps.js": tree["path"] is not None}
    needed |= {"bound.js": tree["bound"] is not None}
    marked = {
        f"/*{file}*/": _UNREAD.sub("", _file(file)) if needed.get(file, True) else ""
        for file in PAGE_FILES
    }
    marked["/*ADDED*/"] = "" if added is None else _UNREAD.sub("", added.script)
    marked |= {"/*DATA*/": data, "TITLE": escape(scenery.words["scene"].replace("_", " "))}
    # in one pass: a name of the user may look like a marker
    return re.sub(
        "|".join(map(re.escape, marked)), lambda found: marked[found.group()], _file("page.html")
    )


def error_of(model: KeptModel) -> dict[str, Json]:
    """Errors shown on a page: their kind, and the largest relative ones at random points of the
    box.
    """
    if flows(model):  # each answer has a separate estimate
        return {"kind": "history", "pressure": None, "forces": None, "points": 0}
    if model.fields.exact:
        return {"kind": "exact", "pressure": 0.0, "forces": 0.0, "points": 0}
    if model.fields.bound is None or model.law.plugin:  # it is that of unilateral contact
        return {"kind": "none", "pressure": None, "forces": None, "points": 0}
    many = model.solve_many(model.parameters.random(PAGE_ERROR_POINTS, 1), raise_on_failure=False)
    described: dict[str, Json] = {"kind": model.fields.bound.kind, "points": PAGE_ERROR_POINTS}
    for name in ("pressure", "forces"):
        errors = relative_errors(many, name)
        described[name] = (
            None if errors is None or not (errors < float("inf")).all() else float(errors.max())
        )
    return described


def _file(name: str) -> str:
    return (resources.files(__package__) / name).read_text(encoding="utf-8")
