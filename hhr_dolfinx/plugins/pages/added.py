"""Interface of plug-ins whose models are more than contact, for pages that solve them too."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from hhr_dolfinx.plugins.pages.packing import Json, Packed

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed import CondensedModel
    from hhr_dolfinx.plugins.pages.scenery import Scenery


class AddedToPage(Protocol):
    """Additions of a plug-in to the page of its contact problem."""

    kind: str  #: name in ``hhr.kinds`` of the class of the script, which derives ``hhr.Model``
    script: str  #: that script
    code: bytes  #: kernel of the page with the functions that the script calls
    contact: CondensedModel  #: contact problem whose kernel this is, whatever it is solved for
    #: the same model as pictures read it: its box, its answers and their fields
    pictured: Any

    size: int  #: bytes of its arrays as text, without pictures

    def tree(
        self, tree: dict[str, Any], scenery: Scenery, arrays: Packed, room: int
    ) -> dict[str, Json]:
        """Entries of the tree of the page that change, or are new.

        Pictures of the contact problem come later, and take the room that is left.

        Args:
            tree: tree of the contact problem, with its kernel.
            scenery: drawn mesh and contact of the scene.
            arrays: packed arrays, to which those of the tree are added.
            room: bytes for all arrays, as text.
        """


@runtime_checkable
class OwnPage(Protocol):
    """A model of a plug-in that is more than contact, and has a page."""

    def on_page(self) -> AddedToPage:
        """Its additions to the page of its contact problem."""
