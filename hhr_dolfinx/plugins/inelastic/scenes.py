"""Checks of scenes with inelastic bodies: the facet ``scene``, see :class:`hhr_dolfinx.body.LawsOfScenes`."""

from __future__ import annotations

from typing import Any

from hhr_dolfinx.body import Body
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.inelastic.constants import parameters_of


def _uneven(body: Body) -> bool:
    """True if more of the elasticity than a common factor depends on parameters or on position."""
    return isinstance(body.poisson, str) or body.grading is not None


class _LawsOfScenes:
    parameters_of = staticmethod(parameters_of)

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


SCENES = _LawsOfScenes()
