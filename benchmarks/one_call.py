"""One call: models that are wished to be 1 % exact, on ten scenes, beside fresh answers of the full
order.

Seven scenes are those of demos, three were written for this benchmark and tried with nothing else.
Each wish is held against 200 fresh points, or ten fresh histories: ``got`` is the worst error of
each norm, ``outcome`` is ``met`` where none is beyond the wish. ``seconds`` are those of the whole
call, with the full model, all checks and timings; ``by_hand_seconds`` those of the full model and
of the way that its authors would take, unchecked.

    python benchmarks/one_call.py [--out DIR] [--quick] [--seed N] [--only NAME]
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import _demos  # noqa: F401 (before the scenes)
import held_by_contact
import hertz_half_discs
import indentation
import pellet_cladding
import pellet_materials
import press_fit
import your_scene
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block, stacked_blocks, two_blocks
from hhr_dolfinx.geometries.two_blocks import side
from hhr_dolfinx.plugins.one_call.context import SearchContext
from hhr_dolfinx.plugins.one_call.target import Budget, Target
from hhr_dolfinx.plugins.one_call.workers import Workers
from hhr_dolfinx.timing import timed, unannounced

ERROR = 0.01
FRESH = 200
HISTORIES = 10
SEED = 31
"""Of fresh points: none of those of a search."""


@dataclass(frozen=True)
class Case:
    """A scene, what is wished of it, and how one makes a model by hand.

    Attributes:
        name: of the scene.
        scene: makes it.
        by_hand: makes a model of its full model.
        of: what is to be exact.
        paths: makes the family of paths of a scene; None where there are none.
    """

    name: str
    scene: Callable[[], hhr.Scene]
    by_hand: Callable[[hhr.FullOrderModel], Any] = partial(hhr.condense, fields=True)
    of: tuple[str, ...] = ("pressure", "displacement")
    paths: Callable[[hhr.Scene], hhr.PathFamily] | None = None


def presses(scene: hhr.Scene) -> hhr.PathFamily:
    """Indentations to some depth and back."""
    own = hhr.ParameterSpace(("d", "sy", "H"), (0.015, 100.0, 1e3), (0.03, 300.0, 10e3))
    legs = hhr.Leg({"depth": "d"}, 1.0, 12), hhr.Leg({"depth": 0.0}, 0.5, 6)
    return hhr.PathFamily(
        "press", scene.parameters, own, {"depth": 0.0, "sy": "sy", "H": "H"}, legs
    )


def condensed_flow(full: hhr.FullOrderModel) -> Any:
    """Sixteen training paths, four for the check, as the demo has them in proportion."""
    family = presses(full.scene)
    training, apart = family.training(16), family.paths(hhr.Sobol(4, seed=5))
    return hhr.train(full.scene, training, held_out=apart).condense()


def soft_block() -> hhr.Scene:
    """Not tuned to: a block over a floor, its modulus over a decade and a half, its ratio of
    Poisson up to 0.47.
    """
    floor, lid = block.side(1, upper=False), block.side(1, upper=True)
    return hhr.Scene(
        name="soft_block",
        geometry=lambda comm: block.block(comm, lower=(0, 0), upper=(3, 1), cells=(36, 12)),
        hypothesis="plane_strain",
        bodies=(hhr.Body(block.SOLID, "10**decade", "nu"),),
        contacts=(hhr.Obstacle(floor, normal=(0, -1), offset=0.02),),
        parameters=hhr.ParameterSpace(("push", "decade", "nu"), (0.0, 0.0, 0.1), (0.4, 1.5, 0.47)),
        displacements=(
            *(hhr.Displacement(block.side(0, upper=end), 0) for end in (False, True)),
            hhr.Displacement(block.side(0, upper=False), 1),
        ),
        loads=(hhr.Pressure(lid, hhr.Amplitude(slopes={"push": 1.0})),),
    )


def warm_stack() -> hhr.Scene:
    """Not tuned to: two blocks with a bulge between them, pushed, sheared and warmed.

    Both moduli are parameters.
    """
    upper = stacked_blocks.UPPER_BLOCK
    faces = (
        stacked_blocks.interface(stacked_blocks.LOWER_BLOCK, 2),
        stacked_blocks.interface(upper, 2),
    )
    return hhr.Scene(
        name="warm_stack",
        geometry=lambda comm: stacked_blocks.stacked_blocks(
            comm, lower=(24, 12), upper=(24, 12), bulge=0.01
        ),
        hypothesis="plane_stress",
        bodies=(hhr.Body(stacked_blocks.LOWER_BLOCK, "E1", 0.3), hhr.Body(upper, "E2", 0.2)),
        contacts=(hhr.NodeToNode(*faces, (0.0, 1.0)),),
        displacements=(
            *hhr.Displacement.clamp(stacked_blocks.outer_end(stacked_blocks.LOWER_BLOCK, 2), 2),
            hhr.Displacement(
                stacked_blocks.outer_end(upper, 2), 1, hhr.Amplitude(slopes={"push": -1.0})
            ),
            hhr.Displacement(stacked_blocks.outer_end(upper, 2), 0),
        ),
        loads=(
            hhr.Traction(side(upper, 0, False), (1.0, 0.0), hhr.Amplitude(slopes={"shear": 1.0})),
            hhr.ThermalExpansion(
                stacked_blocks.LOWER_BLOCK, 1e-4, hhr.Amplitude(slopes={"warm": 1.0})
            ),
        ),
        parameters=hhr.ParameterSpace(
            ("push", "shear", "warm", "E1", "E2"),
            (0.005, -5.0, 0.0, 500.0, 1000.0),
            (0.03, 5.0, 50.0, 3000.0, 9000.0),
        ),
    )


def rubbing_blocks() -> hhr.Scene:
    """Not tuned to: a block pressed on another and drawn aside, with a coefficient of friction that
    is a parameter.
    """
    top = side(two_blocks.SECOND, 1, True)
    faces = side(two_blocks.FIRST, 1, True), side(two_blocks.SECOND, 1, False)
    return hhr.Scene(
        name="rubbing_blocks",
        geometry=lambda comm: two_blocks.two_blocks(
            comm,
            first=((1.0, 0.0), (2.0, 1.0), (12, 12)),
            second=((1.0, 1.0), (2.0, 2.0), (12, 12)),
        ),
        hypothesis="plane_strain",
        bodies=(hhr.Body(two_blocks.FIRST, 3.0, 0.3), hhr.Body(two_blocks.SECOND, 5.0, 0.3)),
        contacts=(hhr.NodeToNode(*faces, (0.0, 1.0), hhr.Coulomb("mu")),),
        parameters=hhr.ParameterSpace(("push", "aside", "mu"), (0.01, 0.0, 0.1), (0.06, 0.02, 0.5)),
        displacements=(
            *hhr.Displacement.clamp(side(two_blocks.FIRST, 1, False), 2),
            hhr.Displacement(top, 0, hhr.Amplitude(slopes={"aside": 1.0})),
            hhr.Displacement(top, 1, hhr.Amplitude(slopes={"push": -1.0})),
        ),
    )


FLOW = Case(
    "indentation",
    partial(indentation.scene, 8),
    condensed_flow,
    ("forces", "displacement"),
    presses,
)
CASES = (
    Case("hertz_half_discs", hertz_half_discs.scene),
    Case("pellet_cladding", pellet_cladding.scene),
    Case("pellet_materials", partial(pellet_materials.scene, **pellet_cladding.QUICK_MESH)),
    Case("leaf_spring", your_scene.scene),
    Case("press_fit", partial(press_fit.scene, **press_fit.QUICK_MESH)),
    Case("o_ring", held_by_contact.o_ring),
    FLOW,
    Case("soft_block", soft_block),
    Case("warm_stack", warm_stack),
    Case("rubbing_blocks", rubbing_blocks),
)
QUICK = ("hertz_half_discs", "soft_block")


def measured(case: Case, fresh: int) -> dict[str, Any]:
    """One row of the report."""
    by_hand = timed(lambda: case.by_hand(hhr.FullOrderModel(case.scene(), MPI.COMM_SELF)))[1]
    scene = case.scene()
    family = None if case.paths is None else case.paths(scene)
    row: dict[str, Any] = {
        "case": case.name,
        "wish": ERROR,
        "of": list(case.of),
        "by_hand_seconds": by_hand,
    }
    model, seconds = timed(lambda: hhr.reduce(scene, ERROR, of=case.of, paths=family))
    reduction = model.reduction
    chosen = reduction.tried[reduction.chosen]
    row |= {
        "method": f"{chosen.method}, {chosen.setting}",
        "full_answers": reduction.full_answers,
        "seconds": seconds,
    }
    row |= {"query_seconds": chosen.query, "known": chosen.known, "said": reduction.met}
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    context = SearchContext(
        full,
        Workers(MPI.COMM_SELF, full, None),
        Target(ERROR, case.of),
        Budget(),
        family,
        SEED,
        unannounced,
    )
    exact = context.fresh(HISTORIES if family is not None else fresh)
    worst = context.errors_of(model, exact).max(axis=0)
    met = bool((worst <= ERROR).all())
    row |= {"got": dict(zip(case.of, worst.tolist(), strict=True)), "fresh": len(exact)}
    return row | {
        "outcome": "met" if met else "not met" if reduction.met else "not met, and said so"
    }


def main() -> None:
    """All cases, one after another."""
    from parts import cli

    from hhr_dolfinx.plugins.studies import report

    parser = cli.demo_parser("one_call", __doc__)
    parser.add_argument("--only", help="the case of this name alone")
    options = cli.parse_on_first_rank(parser)
    rows = []
    for case in CASES:
        if options.only not in (None, case.name) or (options.quick and case.name not in QUICK):
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            row = measured(case, 20 if options.quick else FRESH)
        rows.append(row)
        got = ", ".join(f"{name} {value:.2g}" for name, value in row["got"].items())
        options.console.print(
            f"{row['case']}: {row['outcome']} ({got}) by {row['method']}, {row['full_answers']} "
            f"full answers, {row['seconds']:.3g} s, by hand {row['by_hand_seconds']:.3g} s",
            highlight=False,
        )
    report.write_report({"scene": "one_call", "cases": rows} | report.environment(), options.out)


if __name__ == "__main__":
    main()
