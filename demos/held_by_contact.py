"""Bodies that nothing but contact holds: an O-ring in its groove under a lid, and a punch on a
block.

The rigid motions of such bodies are unknowns beside the contact forces. A lid is pressed by a force
on an O-ring, which lies in a rigid groove and moves outwards as far as the wall; a punch is pressed
and tilted by forces alone.

    K is singular: K R = 0 for rigid motions R. With u = u_0 + R q, balance is  R^T (f - B^T λ) = 0,
    and find λ >= 0 and q:    S λ + s - B R q >= 0,    (B R)^T λ = R^T f,    S = B K_0^-1 B^T of the
    pinned bodies

What to see: forces balance to round-off, in full and in reduced models, though no displacement is
imposed on these bodies; reduced forces are right to a fraction of a per cent at points that were
not trained on.

    python demos/held_by_contact.py [--out DIR] [--quick] [--seed N]
"""

from typing import Any

from parts.o_ring import o_ring_and_lid

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import stacked_blocks as blocks
from hhr_dolfinx.geometries.two_blocks import side


def o_ring(fine: float = 0.06) -> hhr.Scene:
    """A ring of rubber, 4 mm thick, in a groove of 20 mm; lid of steel; mm and MPa."""
    return hhr.Scene(
        name="o_ring",
        geometry=lambda comm: o_ring_and_lid(comm, fine=fine),
        hypothesis="axisymmetric",
        bodies=(hhr.Body("ring", 8.0, 0.49), hhr.Body("lid", 210e3, 0.3)),
        contacts=(
            hhr.NodeToSurface("top", "lid_face"),
            hhr.Obstacle("bottom", normal=(0.0, -1.0), offset=0.0),
            hhr.Obstacle("outside", normal=(1.0, 0.0), offset=22.02),
        ),
        displacements=(),
        loads=(hhr.Pressure("lid_top", hhr.Amplitude(slopes={"pressure": 1.0})),),
        openings=(hhr.Opening(2, hhr.Amplitude(slopes={"play": 1.0})),),
        parameters=hhr.ParameterSpace(("pressure", "play"), (0.02, 0.0), (0.3, 0.1)),
        units=hhr.Units("mm", "MPa"),
    )


def punch(cells: int = 24) -> hhr.Scene:
    """A crowned block on another one, pressed down on its top and on its side."""
    upper, counts = blocks.UPPER_BLOCK, (cells, cells // 2)
    return hhr.Scene(
        name="punch",
        geometry=lambda comm: blocks.stacked_blocks(comm, lower=counts, upper=counts, bulge=0.02),
        hypothesis="plane_strain",
        bodies=(hhr.Body(blocks.LOWER_BLOCK, 1000.0, 0.3), hhr.Body(upper, 3000.0, 0.3)),
        contacts=(
            hhr.NodeToNode(
                blocks.interface(blocks.LOWER_BLOCK, 2), blocks.interface(upper, 2), (0.0, 1.0)
            ),
        ),
        displacements=hhr.Displacement.clamp(blocks.outer_end(blocks.LOWER_BLOCK, 2), 2),
        loads=(
            hhr.Traction(
                blocks.outer_end(upper, 2), (0.0, -1.0), hhr.Amplitude(slopes={"force": 1.0})
            ),
            hhr.Traction(side(upper, 0, False), (0.0, -1.0), hhr.Amplitude(slopes={"aside": 1.0})),
        ),
        parameters=hhr.ParameterSpace(("force", "aside"), (2.0, 0.0), (30.0, 0.5)),
    )


def main() -> None:
    """Both scenes; print the table, write ``report.json`` and the models."""
    from parts import cli
    from parts.held_by_contact_study import measured

    from hhr_dolfinx.plugins.studies import report

    options = cli.parse_on_first_rank(cli.demo_parser("held_by_contact", __doc__))
    found: dict[str, Any] = {
        "scene": "held_by_contact",
        "seed": options.seed,
        "scenes": {},
        **report.environment(),
    }
    rows = []
    for scene in (o_ring(0.15), punch(12)) if options.quick else (o_ring(), punch()):
        found["scenes"][scene.name], row = measured(scene, options)
        rows.append(row)
    report.write_report(found, options.out)
    cli.print_rows("held by contact alone", rows, options.console)


if __name__ == "__main__":
    main()
