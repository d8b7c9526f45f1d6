"""Blocks of other codes as the system of a scene: their elements, our contact."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

from hhr_dolfinx.body import Body
from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.foreign.block import ForeignBlock

if TYPE_CHECKING:
    from mpi4py import MPI

    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.full_order.system import Made, Middle, System
    from hhr_dolfinx.models.condensed import CondensedModel
    from hhr_dolfinx.pairings import Pairing
    from hhr_dolfinx.parameters import ParameterSpace
    from hhr_dolfinx.plugins.foreign.discretisation import ForeignDiscretisation
    from hhr_dolfinx.scene import Scene


@dataclass(frozen=True, init=False)
class ForeignStiffness(KnownArguments):
    """The stiffness of a scene, in blocks that other finite element codes have written.

    ``Scene(geometry=foreign.geometry, bodies=foreign.bodies, system=foreign, hypothesis="solid",
    ...)``, or shorter ``foreign.scene("part", contacts=..., ...)``. Surfaces and sets of the blocks
    are tags; if there are several blocks they are ``block.NAME``.

    Args:
        blocks: parts, each with its K.
    """

    blocks: tuple[ForeignBlock, ...]

    def __init__(self, *blocks: ForeignBlock):
        object.__setattr__(self, "blocks", tuple(blocks))
        if not blocks or not all(isinstance(block, ForeignBlock) for block in blocks):
            raise SceneError(
                f"ForeignStiffness{blocks!r} needs blocks, ForeignBlock(stiffness, nodes, case)"
            )
        names = [block.name for block in blocks]
        if len(set(names)) < len(names):
            raise SceneError(
                f"blocks of a foreign stiffness have the names {names}: give each a different name"
            )

    def __call__(self, problem: ContactProblem, middle: Middle, made: Made) -> System:
        """The system of a problem whose parts are the K of the blocks, with their factors as
        moduli.
        """
        from hhr_dolfinx.full_order.system import system_of

        return system_of(problem, middle, made)

    @property
    def bodies(self) -> tuple[Body, ...]:
        """A body for each block; its modulus is the factor of K, and no stress is computed of
        it.
        """
        return tuple(Body(block.name, _number(block.factor), 0.0) for block in self.blocks)

    @property
    def geometry(self) -> Callable[[MPI.Comm], NoReturn]:
        """Geometry of a scene that has no mesh."""
        return NoMesh(tuple(block.name for block in self.blocks))

    @property
    def unchecked(self) -> tuple[str, ...]:
        """Names of the blocks without a solved case."""
        return tuple(block.name for block in self.blocks if block.case is None)

    @property
    def discretised(self) -> type[ForeignDiscretisation]:
        """Class that makes matrices and contact conditions of a scene with this system."""
        from hhr_dolfinx.plugins.foreign.discretisation import ForeignDiscretisation

        return ForeignDiscretisation

    def scene(self, name: str, **parts: Any) -> Scene:
        """A scene of these blocks.

        Args:
            name: name of the scene.
            parts: arguments of :class:`~hhr_dolfinx.scene.Scene` other than geometry, bodies,
                hypothesis and system.
        """
        from hhr_dolfinx.scene import Scene

        arguments: dict[str, Any] = {
            "geometry": self.geometry,
            "bodies": self.bodies,
            "hypothesis": "solid",
            "system": self,
        }
        return Scene(name=name, **(arguments | parts))

    def condense(
        self, parameters: ParameterSpace, contacts: Sequence[Pairing], **parts: Any
    ) -> CondensedModel:
        """Condense without a scene, DOLFINx or PETSc, see :func:`condense_blocks`.

        Args:
            parameters: box of the parameters.
            contacts: contact pairs without laws.
            parts: displacements, loads, openings and outputs.
        """
        from hhr_dolfinx.plugins.foreign.condense import condense_blocks

        return condense_blocks(self, parameters, contacts, **parts)


@dataclass(frozen=True)
class NoMesh:
    """Geometry of a scene whose blocks come from other codes.

    Attributes:
        blocks: names of the blocks, for messages.
    """

    blocks: tuple[str, ...]

    def __call__(self, comm: MPI.Comm) -> NoReturn:
        """Refuse: what needs a mesh of DOLFINx is not built in for foreign blocks."""
        raise SceneError(
            f"blocks {', '.join(self.blocks)} have no mesh of DOLFINx: their K comes from another "
            "code. Give the scene "
            "system=ForeignStiffness(...), of which this is the geometry"
        )


def _number(factor: str | float) -> str | float:
    return factor if isinstance(factor, str) else float(factor)
