"""Fuel pellet in its cladding on meshes that do not match, thesis section 5.3.

As ``pellet_cladding.py``, with 76 instead of 100 cells along the cladding: N = 13,708, and 101
conditions on the side of the pellet, which is the slave surface. The reduced problem is a
generalised saddle point (5.27) on a closed RID.

    K~ γ + B~_1^T λ = f~,    B~_2 γ <= g~,    B~_1 = B V on A,  B~_2 = B V on A and its interface
    (5.23), (5.26)

What to see: the thesis' recipe on a small RID is refused, cond(K~) is 1e9 although both inf-sup
constants are perfect; with layers of cells it answers. The default recipe is as good as on matching
meshes; mortar costs the same.

    python benchmarks/thesis/pellet_cladding_nonmatching.py [--out DIR] [--quick] [--seed N]
        [--pairing mortar] [--bottom held]
"""

import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pellet_cladding as matching

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.geometries import pellet_cladding as geometry
from hhr_dolfinx.materials.elasticity import von_mises

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.studies.study import Study

POINT = (190.0, 5.2)
THESIS = {"primal_l2": 0.021, "dual_rid": 0.039, "von_mises": 0.0076, "sigma_rr": 0.0078}
"""Errors of the thesis at the point, section 5.3.2."""
PAIRINGS = {"node_to_surface": "NodeToSurface", "mortar": "Mortar", "double_pass": "DoublePass"}


def VIEW() -> "hhr.View":
    """Pictures of a study, at the point of the thesis."""
    return matching.VIEW((POINT,))


def scene(
    pairing: str = "node_to_surface", bottom: str = "obstacle", **mesh_options: Any
) -> hhr.Scene:
    """The scene in mm and MPa; the mesh options are those of :func:`geometry.pellet_cladding`."""
    base = matching.scene(bottom, **{"cladding_axial_cells": 76, **mesh_options})
    side = getattr(hhr, PAIRINGS[pairing])(
        geometry.PELLET_SIDE, geometry.CLADDING_INNER, normal=(1.0, 0.0)
    )
    return dataclasses.replace(
        base, name="pellet_cladding_nonmatching", contacts=(side, *base.contacts[1:])
    )


def variants() -> Iterator[tuple[str, hhr.Recipe]]:
    """The thesis' recipe, with layers added, and the default one with fewer modes."""
    thesis = {
        "nodes": (hhr.Deim(), hhr.ForceDeim(1e-3), hhr.LoadNodes()),
        "enrichment": hhr.Enrich(1.0),
    }
    for layers in (0, 1, 2, 4):
        yield (
            f"thesis, {layers} layers",
            hhr.Recipe.thesis(1e-6, domain=hhr.Rid(layers, 0), **thesis),
        )
    for tolerance in (1e-9, 1e-10):
        yield f"relative {tolerance:.0e}", hhr.Recipe(hhr.Pod(tolerance, relative=True))


def errors_at_point(study: "Study") -> dict[str, float]:
    """Errors at the point of section 5.3.2 in the norms of the thesis."""
    full, inside = study.training.full_order, study.model.fields.A_lambda
    answers = study.model.solve(POINT), full.solve(POINT)
    return {
        "primal_l2": relative_error(
            *(answer.displacement() for answer in answers), full.problem.mass
        ),
        "dual_rid": relative_error(*(answer.forces()[inside] for answer in answers)),
        "von_mises": relative_error(*(von_mises(answer.stress()) for answer in answers)),
        "sigma_rr": relative_error(*(answer.stress()[:, 0] for answer in answers)),
    }


def main() -> None:
    """Train, study, report."""
    sys.path.append(str(Path(__file__).parents[2] / "demos"))
    from parts import cli
    from thesis_output import print_beside

    parser = cli.demo_parser("pellet_cladding_nonmatching", __doc__)
    parser.add_argument("--pairing", choices=PAIRINGS, default="node_to_surface")
    parser.add_argument("--bottom", choices=("obstacle", "held"), default="obstacle")
    options = cli.parse(parser)
    mesh = {**matching.QUICK_MESH, "cladding_axial_cells": 15} if options.quick else {}
    settings = hhr.StudySettings(matching.GRID, variants=list(variants()), queries=100)
    settings = settings.adapted(seed=options.seed, quick=options.quick)
    built = scene(options.pairing, options.bottom, **mesh)
    study = hhr.study_scene(built, settings, options.out, progress=options.progress)
    if study is not None:  # ranks but the first have only trained
        here = errors_at_point(study)
        study.report["point"] = {"P1, h1": POINT, "thesis": THESIS, "here": here}
        study.write(options.out, options.console, VIEW())
        print_beside(
            "errors", {"190 MPa, 5.2 mm": here}, {"190 MPa, 5.2 mm": THESIS}, options.console
        )


if __name__ == "__main__":
    main()
