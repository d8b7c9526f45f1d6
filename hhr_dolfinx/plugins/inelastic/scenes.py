"""Checks of scenes with inelastic bodies: the facet ``scene``, see :class:`hhr_dolfinx.body.LawsOfScenes`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.inelastic import constants

if TYPE_CHECKING:
    from hhr_dolfinx.body import Body


def _uneven(body: Body) -> bool:
    """True if more of the elasticity than a common factor depends on parameters or on position."""
    return isinstance(body.poisson, str) or body.grading is not None


class _LawsOfScenes:
    def check_body(self, body: Body) -> None:
        """Raise SceneError for elasticity that varies in space, or a ratio that is a formula."""
        if _uneven(body):
            raise SceneError(
                f"body {body.tag} flows, and its Poisson's ratio depends on parameters, or its elasticity on the "
                "place: that is not built in, only young may be a formula. Give it a constant poisson, or a scene for "
                "each of its values, and no grading"
            )

    def check_scene(self, scene: Any) -> None:
        """Raise SceneError for other bodies of such elasticity, and for shapes."""
        others = [body.tag for body in scene.bodies if _uneven(body)]
        if others:
            raise SceneError(
                f"bodies of scene '{scene.name}' flow, and Poisson's ratio of bodies {others} depends on parameters, "
                "or their elasticity on the place: that is not built in, only young may be a formula. Give these a "
                "constant poisson and no grading"
            )
        if scene.shapes:
            raise SceneError(
                f"bodies of scene '{scene.name}' flow, and their shape depends on parameters: not built in"
            )

    def parameters_of(self, law: object) -> set[str]:
        """Names of the parameters on which a law depends."""
        return constants.parameters_of(law)


SCENES = _LawsOfScenes()
