"""The command ``hhr check``: a scene, or a mesh file, before anything is solved."""

from __future__ import annotations

import sys
from pathlib import Path

from hhr_dolfinx.command.speaking import guarded, spoken
from hhr_dolfinx.command.words import AT, EXIT_NO_ANSWER, SCENE, examples
from hhr_dolfinx.compat import extra
from hhr_dolfinx.registry import named, offered

with extra("study", "the command hhr"):
    import click

PICTURE_ENDINGS = (".png", ".pdf", ".svg")
"""Endings of pictures of a scene."""
MESHES = frozenset(
    ".msh .inp .e .ex2 .exo .xdmf .vtk .vtu .med .unv .bdf .nas .cgns .su2 .mesh".split()
)
"""Endings of mesh files, which are never scenes."""
MOST_NAMES = 1000
"""Bodies, surfaces and sets of a mesh file that are listed."""
MOST_PAIRS = 20
"""Pairs of surfaces that are listed, those with the smallest gaps."""


@click.command(
    epilog=examples(
        "hhr check my_scene.py", "hhr check my_scene.py --at load=3", "hhr check part.msh"
    )
)
@SCENE
@AT
@click.option(
    "--picture",
    type=click.Path(path_type=Path),
    help="where to draw it; scenes as [<scene>_check.png]",
)
@click.option(
    "--mesh-error", is_flag=True, help="solve once in full, and estimate how far the mesh is off"
)
@guarded
def check(scene: str, words: tuple[str, ...], picture: Path | None, mesh_error: bool) -> None:
    """Look at a scene without solving it: tags, supports, surfaces, gaps, loads, parameters.

    With a picture.

    SCENE may be a mesh file too, or a deck: its bodies, surfaces and sets are listed, what is left
    out of it, and which surfaces can be contacts, since they face each other; with --picture they
    are drawn.

    With --mesh-error it is solved once, in full, and the error of the mesh is estimated.
    """
    from hhr_dolfinx.command.loading import checked_target, point_of, scene_of

    checked_target(picture, PICTURE_ENDINGS)
    console, _ = spoken()
    if _is_mesh(scene):
        if words or mesh_error:
            raise click.UsageError(f"{scene} is a mesh: --at and --mesh-error are for scenes")
        console.print(_contents_of(scene, picture), highlight=False, markup=False, soft_wrap=True)
        return
    from hhr_dolfinx.plugins.scene_checks.check import check_scene

    loaded = scene_of(scene)
    picture = picture or Path(f"{loaded.name}_check.png")
    checked_target(picture, PICTURE_ENDINGS)
    point = point_of(words, loaded.parameters, others=loaded.parameters.middle) if words else None
    scene_check = check_scene(loaded, point)
    if mesh_error and not scene_check.mistakes:
        from hhr_dolfinx.plugins.scene_checks.mesh import look_at_mesh_error

        look_at_mesh_error(scene_check, point)
    for finding in scene_check.findings:
        console.print(f"{finding.level:8} {finding.text}", highlight=False)
    if scene_check.discretisation is not None and scene_check.discretisation.has_mesh:
        from hhr_dolfinx.plugins.scene_checks.drawing import figure_of_scene

        figure_of_scene(scene_check).savefig(picture, dpi=150)
        console.print(f"picture: {picture}")
    sys.exit(EXIT_NO_ANSWER if scene_check.mistakes else 0)


def _is_mesh(name: str) -> bool:
    """True for the name of a mesh file, or of a file or folder that cannot be anything else."""
    path = Path(name)
    endings = MESHES | named("readers").keys()
    return (path.exists() and path.suffix not in (".py", ".npz")) or path.suffix.lower() in endings


def _contents_of(name: str, picture: Path | None) -> str:
    """Contents of a mesh file, which may be drawn, pairs of surfaces for contacts, and how a scene
    refers to it.
    """
    from hhr_dolfinx.geometries.mesh_file import MeshFile
    from hhr_dolfinx.geometries.summary import summary_of
    from hhr_dolfinx.plugins.scene_checks.candidates import contact_candidates

    raw = MeshFile(name).read()
    text = summary_of(raw, Path(name)).text(MOST_NAMES)
    gaps = contact_candidates(raw)
    pairs = [
        f"    {names}: {'gap' if gap >= 0 else 'overlap'} {abs(gap):.3g}" for names, gap in gaps
    ]
    if pairs:
        more = f"\n    and {len(pairs) - MOST_PAIRS} more" if len(pairs) > MOST_PAIRS else ""
        lines = "\n".join(pairs[:MOST_PAIRS])
        title = "surfaces that face each other, for contacts, with the smallest gaps of flat facets"
        text = f"{text}\n  {title}:\n{lines}{more}"
    elif raw.points.shape[1] > raw.dim:
        text = (
            f"{text}\n  the cells are shells in space, which are not supported: "
            "mesh the volume of the bodies"
        )
    elif not raw.all_surfaces():
        text = f"{text}\n  no surface has a name: `hhr start {name}` names the sides of the bodies"
    geometry = f"its geometry, hhr.MeshFile({name!r})"
    if (folded := offered("folded")) and (message := folded(raw, name)):
        text = f"{text}\n{message}"
        geometry = "this geometry"
    if picture is not None:
        from hhr_dolfinx.plugins.scene_checks.drawing import figure_of_mesh

        figure_of_mesh(raw, Path(name).name).savefig(picture, dpi=150)
        text = f"{text}\npicture: {picture}"
    return f"{text}\nA scene names these as Body, contacts and loads of {geometry}"
