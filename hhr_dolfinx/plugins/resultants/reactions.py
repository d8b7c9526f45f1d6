"""Reactions of supports: rows of K, B^T and loads on imposed dofs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, vstack

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.models.functionals.functional import Functional
from hhr_dolfinx.models.functionals.kinds import Linear
from hhr_dolfinx.outputs import ModelProbe, NamedOutput, no_axis, place_of, unit_vector
from hhr_dolfinx.parameters import Place, Tag, check_place
from hhr_dolfinx.plugins.resultants.kinds import ReactionTerms

FORCE = "force"
MOMENT = "moment"
WORK = "work"
KINDS = (FORCE, MOMENT, WORK)
"""Kinds of reactions."""


@dataclass(frozen=True)
class Reaction(NamedOutput):
    """Force, moment or work of a support or of a driven surface, on the body that it holds.

    It is K u - F + B^T λ on the dofs that displacements of the tag impose: with all loads and
    contacts, reactions balance. A dof on which several tags impose a displacement counts for the
    first of them in the scene, so that the sum of all reactions is right. Forces are per unit depth
    in the plane, and of the whole turn in axisymmetry.

    Attributes:
        tag: tag, set or place of the imposed displacements, as in the scene.
        direction: direction of the component of a force, of any length; in axisymmetry the first
            component sums radial forces around the turn.
        about: reference point of a moment, in the unit of length.
        axis: axis of a moment in space, right-handed, with arms in the undeformed mesh; None in the
            plane, for the normal of the plane.
        kind: ``force``, ``moment``, or ``work``, the sum of reactions times imposed displacements
            at the end of a step. It is twice the work done if reactions have grown in proportion to
            displacements all the way, which contact that opens and friction do not let them.

    Raises:
        SceneError: for a direction, point or axis that the kind does not take or lacks.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> from hhr_dolfinx.geometries import block
        >>> held = hhr.Reaction("held", block.side(0, upper=False), direction=(0, 1), unit="N/mm")
        >>> lift = hhr.ContactForce("lift", contact=0, direction=(0, 1), unit="N/mm")
        >>> outputs = hhr.condense(replace(scene, outputs=(held, lift))).outputs({"push": 50.0})
        >>> round(outputs["held"], 1), round(outputs["held"] + outputs["lift"], 6)
        (31.5, 100.0)
    """

    vectors: ClassVar[tuple[str, ...]] = ("direction", "about", "axis")

    tag: Tag | Place
    direction: tuple[float, ...] | None = None
    about: tuple[float, ...] | None = None
    axis: tuple[float, ...] | None = None
    kind: str = FORCE

    def __post_init__(self) -> None:
        super().__post_init__()
        check_place(f"the support of output '{self.name}'", self.tag)
        if self.kind not in KINDS:
            kinds = ", ".join(repr(kind) for kind in KINDS)
            raise SceneError(f"output '{self.name}': the kind {self.kind!r} must be one of {kinds}")
        needed = {FORCE: "direction", MOMENT: "about", WORK: ""}[self.kind]
        for name in ("direction", "about"):
            if (getattr(self, name) is None) == (name == needed):
                verb = "needs" if name == needed else "takes no"
                raise SceneError(f"output '{self.name}': a {self.kind} {verb} {name}")
        if self.axis is not None and self.kind != MOMENT:
            raise SceneError(f"output '{self.name}': an axis is for a moment, leave it out")

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`~hhr_dolfinx.outputs.Output`.

        Args:
            probe: interface of the model.

        Raises:
            SceneError: if no displacement names the tag, or for bodies with laws, shapes that
                depend on parameters, and user-defined systems.
        """
        return reaction_of(probe, self)


def reaction_of(probe: ModelProbe, output: Reaction) -> Functional:
    """Reaction of the dofs that a tag imposes.

    Args:
        probe: interface of the model.
        output: the output.

    Raises:
        SceneError: if no displacement names the tag, or if K u is not all of the inner forces.
    """
    _check(probe, output)
    problem = probe.problem
    dofs = _imposed_dofs(probe, output)
    directions, factors = _directions(probe, output, dofs)
    stiffness = problem.stiffness_terms
    prolongation = problem.prolongation
    rows = [_summed(probe, directions, block) for block in stiffness]
    # T^T K (u - L θ) + T^T K L θ: the two lifts differ where equations tie dofs
    pulls = [directions @ prolongation.restrict(pull) for pull in problem.pulls]
    pairs = zip(pulls, rows, strict=True)
    lifted = [csr_matrix(pull - row @ problem.lifts) for pull, row in pairs]
    if prolongation.map is None:  # they are the same, up to round-off
        lifted = [csr_matrix(block.shape) for block in lifted]
    contact = csr_matrix(directions @ prolongation.restrict(csc_matrix(probe.contact_rows.T)))
    external = csr_matrix(directions @ prolongation.restrict(problem.forces))
    conditions = np.unique(contact.indices).astype(np.int64)
    terms = np.unique(np.concatenate([block.indices for block in (*lifted, external)]))
    terms = terms.astype(np.int64)
    weights = contact[:, conditions].toarray()
    of_loads = external[:, terms].toarray()
    if len(stiffness) == 1 and not problem.moduli and (factors < 0).all():
        numbers = (lifted[0][:, terms].toarray() - of_loads)[0]
        options = {"row": csr_matrix(rows[0]), "terms": terms, "coefficients": numbers}
        return Linear.of(output.name, output.unit, conditions, weights[0], **options)
    count = len(factors)
    order = np.arange(len(stiffness) * count).reshape(len(stiffness), count).T.ravel()
    matrix = csr_matrix(vstack(rows))[order].tocoo()
    of_lifts = vstack([block[:, terms] for block in lifted]).toarray()[order]
    moduli = tuple(f"({modulus.factor}) * ({modulus.rest})" for modulus in problem.moduli) or ("1",)
    indices = matrix.row.astype(np.int64), matrix.col.astype(np.int64)
    entries = matrix.shape[0], *indices, matrix.data
    names = problem.parameters.names
    arrays = conditions, weights, factors, terms, of_lifts, of_loads
    return ReactionTerms(output.name, output.unit, *entries, names, moduli, *arrays)


def _check(probe: ModelProbe, output: Reaction) -> None:
    """Refuse scenes in which K u is not all of the inner forces, or K is another one elsewhere."""
    scene = probe.scene
    message = f"output '{output.name}': a reaction is K u - F + B^T λ on imposed dofs"
    if probe.laws is not None:
        raise SceneError(
            f"{message}, and the inner forces of bodies with laws are ∫ B^T σ of a path. Take the "
            "ContactForce of the contact that bears the load, or leave it out"
        )
    if scene.shapes:
        raise SceneError(
            f"{message}, and its rows of K change with the shapes of scene '{scene.name}', which "
            "is not built in: take the ContactForce that bears the load, or leave it out"
        )
    if scene.system is not None:
        raise SceneError(f"{message}, and K of a user-defined system is not that of the bodies")
    tags = list(dict.fromkeys(str(displacement.tag) for displacement in scene.displacements))
    if output.tag not in [displacement.tag for displacement in scene.displacements]:
        raise SceneError(
            f"output '{output.name}': no displacement is imposed on {output.tag!r}: name one of "
            f"{', '.join(tags) or 'none'}"
        )


def _imposed_dofs(probe: ModelProbe, output: Reaction) -> np.ndarray:
    """Dofs that displacements of the tag impose, and none before them in the scene."""
    space = probe.discretisation
    imposed_before = np.zeros(probe.problem.free.size, dtype=bool)
    chosen = []
    for displacement in probe.scene.displacements:
        dofs = space._tagged_dofs(displacement.tag, displacement.component)
        if displacement.tag == output.tag:
            chosen.append(dofs[~imposed_before[dofs]])
        imposed_before[dofs] = True
    dofs = np.unique(np.concatenate(chosen))
    if not dofs.size:
        raise SceneError(
            f"output '{output.name}': other displacements impose all dofs of {output.tag!r}, and "
            "their reactions count for the first in the scene: name that one"
        )
    return dofs


def _directions(
    probe: ModelProbe,
    output: Reaction,
    dofs: np.ndarray,
) -> tuple[csr_matrix, np.ndarray]:
    """Weights of the dofs, (j, N), and the amplitude of each j by its index; -1 for 1."""
    problem = probe.problem
    dim = probe.dimension
    size = problem.free.size
    constant = np.array([-1])
    if output.kind == "work":
        lifts = csr_matrix(problem.lifts)[dofs]
        terms = np.unique(lifts.indices)
        if not terms.size:
            raise SceneError(
                f"output '{output.name}': no motion is imposed on {output.tag!r}, so that its "
                "reaction does no work: name a driven surface"
            )
        selection = csr_matrix(
            (np.ones(dofs.size), (dofs, np.arange(dofs.size))), (size, dofs.size)
        )
        return csr_matrix((selection @ lifts[:, terms]).T), terms.astype(np.int64)
    if output.kind == "force":
        along = unit_vector(output, "direction", dim)[dofs % dim]
    else:
        along = _arms(probe, output, dofs)
    return csr_matrix((along, (np.zeros(dofs.size, dtype=int), dofs)), (1, size)), constant


def _arms(probe: ModelProbe, output: Reaction, dofs: np.ndarray) -> np.ndarray:
    """Moments of unit forces on dofs about a point, (k,)."""
    if probe.scene.hypothesis == "axisymmetric":
        raise SceneError(f"output '{output.name}': the moment of axisymmetric forces vanishes")
    dim = probe.dimension
    nodes, axes = np.divmod(dofs, dim)
    arms = probe.problem.points[nodes] - place_of(output, "about", dim)
    if dim == 2:
        no_axis(output)
        turned = np.column_stack([-arms[:, 1], arms[:, 0]])
    else:
        turned = np.cross(unit_vector(output, "axis", 3), arms)
    return turned[np.arange(dofs.size), axes]


def _summed(probe: ModelProbe, directions: csr_matrix, part: csr_matrix) -> csr_matrix:
    """Weighted sums of the rows of a part of K, (j, N), of which each process has some."""
    problem = probe.problem
    local = directions[:, problem.rows] @ part
    return csr_matrix(sum(problem.group.gathered(local)))
