"""Why compositions are refused: for each verb, the function of the package that refuses, with its
reason.

A sentence states the mathematical reason. One that opens with "Not built in" says that there is
none: the composition has a meaning, and nobody has written it. All verbs refuse what the full model
refuses, so that its reasons come first.
"""

from __future__ import annotations

REFUSED = {
    "plugins/contact_laws/interface.py:check_areas": (
        "double_pass+gasket double_pass+soft_contact double_pass+wear"
    ),
    "plugins/shapes/reshaped.py:_check_areas": "own_contact_law+shape",
    "plugins/constraints/elimination.py:_check_kept": "directed+preload",
    "plugins/inelastic/outside.py:statement": "external_law+plane_stress",
    "plugins/shapes/reshaped.py:_check_constraints": "rigid_motion+shape",
    "plugins/shapes/reshaped.py:check_still": "moving_circle+shape",
    "plugins/rigid_tools/drive.py:_check_scene": "driven_tool+own_system",
    "plugins/sliding/slide.py:_check": "double_pass+sliding driven_tool+sliding",
    "plugins/sliding/slide.py:_check_shapes": "shape+sliding",
    "plugins/sliding/slide.py:slide": "floating+sliding",
    "scene.py:_check_system": (
        "external_law+own_system norton+own_system own_body_law+own_system own_system+shape "
        "own_system+voce"
    ),
}
"""Pairs that the full model refuses, by the place that refuses them: all pairs are tried, and no
others are refused.
"""

_CODE = (
    "Files, pages and headers hold no code: a law is a program that UFL translates, and other "
    "code has none."
)
_PROPORTIONAL = (
    "K is a sum of two matrices whose weights depend on Poisson's ratio: its inverse is no factor "
    "times a constant, which is what the elastic response of a condensed step with laws of bodies "
    "is. With shapes its strains change too. Interpolated responses are not built in there."
)
_NO_MODULI = (
    "Not built in: where surfaces slide, a model condenses one compliance of the surfaces, and "
    "moduli of parameters would need one for each point, steps of bodies with laws one for each "
    "linearisation."
)
_KINKS = (
    "Answers have kinks where a node passes an edge of a facet, beside those of statuses. Between "
    "kinks derivatives of the rows along a path are needed: not built in."
)
_ELASTIC = (
    "Corrections of elastic steps are round-off: no modes follow from them, and exact "
    "condensation is there."
)
_SMALL = {
    "plugins/contact_laws/reduction.py:completed": (
        "Not built in: a step of a law starts from the memory on the RID, and the answer before "
        "has that of the whole surface, whose order there the step of bodies with laws does not "
        "know."
    ),
    "plugins/inelastic/elastic_response.py:parts_of": _PROPORTIONAL,
    "plugins/inelastic/outside.py:program": _CODE,
    "plugins/sliding/slide.py:slide": _NO_MODULI,
}
_SUPPORTS = (
    "S grows without limit where a foundation vanishes and contact alone holds the body: nothing "
    "interpolates it up to that corner of the box."
)
_EXPORT = _SMALL | {
    "plugins/inelastic/condense_flow.py:check": _ELASTIC,
    "plugins/pages/arrays.py:check_model": (
        "Not built in: a page solves a problem with one B, and where surfaces slide past their "
        "mesh rows are made again in each increment, by searches on both surfaces."
    ),
    "plugins/pages/laws.py:check_law": (
        "Not built in: the kernel corrects inelastic bodies with one contact problem for each "
        "iterate, by an active set or by friction; laws on ranges are solved there with elastic "
        "bodies alone."
    ),
    "plugins/moduli/condense.py:_check_supports": _SUPPORTS,
}

REASONS: dict[str, dict[str, str]] = {
    "full": {
        "plugins/contact_laws/interface.py:check_areas": (
            "Both passes have areas, which overlap: a law of pressures divides forces by areas, "
            "and those of a condition are no part of the surface of its own."
        ),
        "plugins/shapes/reshaped.py:_check_areas": (
            "Not built in: a force is a pressure times an area, which changes with the shape of "
            "the slave's body, and the law keeps the areas of one shape. A law of ratios of "
            "forces, such as Coulomb's, needs none."
        ),
        "plugins/constraints/elimination.py:_check_kept": (
            "An equation between imposed displacements alone has no unknown: if their values "
            "break it, no displacement satisfies both."
        ),
        "plugins/inelastic/outside.py:statement": (
            "Not built in: in plane stress the strain across is an unknown of the law, solved in "
            "UFL around it, and code outside of UFL is called for a whole strain."
        ),
        "plugins/shapes/reshaped.py:_check_constraints": (
            "Not built in: means over a surface and rigid motions have areas and places as "
            "coefficients, which move with the shape, and T of U = T V + L theta is that of all "
            "points."
        ),
        "plugins/shapes/reshaped.py:check_still": (
            "Gaps are sums D theta, with a column for each term. The gap of a node to a curved "
            "surface is nonlinear in the places of both: where both depend on parameters it is no "
            "sum over the obstacle's: not built in."
        ),
        "plugins/rigid_tools/drive.py:_check_scene": (
            "A user-defined system states K of all dofs of the mesh, and those of the cell of a "
            "tool are not among them."
        ),
        "plugins/sliding/slide.py:_check": (
            "While surfaces slide, nodes of one pass those of the other, where rows of both "
            "passes are dependent: pressures have no single value. Tools that are driven beside "
            "such pairs are not built in."
        ),
        "plugins/sliding/slide.py:_check_shapes": (
            "Not built in: increments that pair surfaces again solve for forces by one compliance "
            "of the surfaces, which shapes change."
        ),
        "plugins/sliding/slide.py:slide": (
            "Not built in: motions R of a body that contact alone holds are unknowns, with rows B "
            "R, and rows B of surfaces that slide are made again in each increment."
        ),
        "scene.py:_check_system": (
            "A law states the stress of its body, and a shape the mesh on which K is assembled; a "
            "system states K of all bodies. Of two statements of one K one would be left out."
        ),
    },
    "gradient": {
        "plugins/inelastic/full_order.py:_marching": (
            "Not built in: strains at fixed displacements change with the shape, and derivatives "
            "of steps have none of these terms."
        ),
        **dict.fromkeys(
            ("plugins/sliding/model.py:increments", "plugins/sliding/law.py:no_slopes"), _KINKS
        ),
    },
    "condense": {
        **_SMALL,
        "plugins/inelastic/condense_flow.py:check": _ELASTIC,
        "plugins/moduli/condense.py:_check_supports": _SUPPORTS,
    },
    "HHR": {
        "linear/sparse.py:refactor": (
            "Where a foundation vanishes and contact alone holds the body, K of a training point "
            "is singular."
        ),
        "benchmarks": (
            "Not built in: a basis and a RID are those of one B, and where surfaces slide past "
            "their mesh B is made again in each increment. A training takes usual full models."
        ),
        "certify/trust.py:check_comparison": (
            "No part is missing: a model is compared with answers that were held out, and refused "
            "for its error, which is infinite where its contact leaves the displacement of a body "
            "open."
        ),
        "certify/trust.py:check_solvable": (
            "Rows of conditions are dependent on the basis: their forces have no single value, "
            "thesis (1.67). If two conditions have one row, no basis tells them apart."
        ),
        "certify/trust.py:check_stability": (
            "The inf-sup constant of contact on the RID is zero: some force there does no work on "
            "any mode, and has no single value."
        ),
        "plugins/contact_laws/reduction.py:completed": _SMALL[
            "plugins/contact_laws/reduction.py:completed"
        ],
        "plugins/inelastic/reduction.py:check": (
            "Not built in: strains of modes and weights of Gauss points are integrals on one "
            "mesh, and change with the shape."
        ),
    },
    "page": _EXPORT,
    "C": _EXPORT,
    "file": _SMALL,
    "estimate": _SMALL,
    "neutral": {
        "linear/sparse.py:__init__": (
            "Springs of stiffness zero hold nothing: K of a body that they alone hold is singular."
        ),
        "models/answer.py:outcome": (
            "Conditions that touch are linearly dependent, thesis (1.67): their forces have no "
            "single value."
        ),
    },
}
"""Reasons by verb and by place, ``file:function`` in the package as rows of a report have it."""


def reason(verb: str, place: str) -> str:
    """Reason of a refusal by its verb, by the full model, or by any solution.

    Empty for a place that has none.
    """
    own = REASONS.get(verb, {}).get(place) or REASONS["full"].get(place)
    return own or REASONS["neutral"].get(place, "")


def refused_pairs() -> dict[frozenset[str], str]:
    """Place that refuses the full model of each pair in :data:`REFUSED`."""
    return {
        frozenset(pair.split("+")): place
        for place, pairs in REFUSED.items()
        for pair in pairs.split()
    }
