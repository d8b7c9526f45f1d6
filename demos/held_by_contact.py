"""Bodies that nothing but contact holds
=====================================

A lid is pressed by a force on an O-ring of rubber, which lies in a rigid groove and moves outwards
as far as the wall. In a second scene a punch is pressed and tilted on a block by forces alone. No
displacement is imposed on ring, lid and punch, so that their stiffness is singular.

.. image:: /pictures/held_by_contact.png
   :alt: Section of the O-ring under its lid with its stress, and pressures on lid, groove and wall

Forces balance to round-off, in full and in reduced models. Reduced forces are right to a fraction
of a per cent at points that were not trained on. The rigid motions of such bodies are found with
the contact forces: where the ring comes to lie is part of the answer.

You learn that such a scene needs no weak springs and no further supports: leave ``displacements``
empty, and the rigid motions become unknowns beside the contact forces. If the loads leave a motion
undetermined, the message names it.

.. code-block:: text

    K R = 0 for rigid motions R;    u = u_0 + R q,    R^T (f - B^T λ) = 0
    find λ >= 0 and q:    S λ + s - B R q >= 0,    (B R)^T λ = R^T f
    S = B K_0^-1 B^T of the pinned bodies

.. code-block:: sh

    python demos/held_by_contact.py [--out DIR] [--quick] [--seed N]
"""

# sphinx_gallery_thumbnail_path = "pictures/held_by_contact.png"

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
