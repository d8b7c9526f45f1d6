"""The command ``hhr solve``: the answer of one parameter."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.command.speaking import first_rank, guarded
from hhr_dolfinx.command.words import AT, KNOWN_OPTION, examples
from hhr_dolfinx.compat import extra

if TYPE_CHECKING:
    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.models.histories.equilibrium import StepOptions
    from hhr_dolfinx.models.model import AnsweringModel
    from hhr_dolfinx.scene import Scene

with extra("study", "the command hhr"):
    import click

FIELDS = (".vtkhdf", ".vtu")


def largest_values(
    answer: Answer,
    dimension: int,
    scene: Scene | None,
    problem: ContactProblem | None,
    forces: np.ndarray,
) -> dict[str, float]:
    """Largest displacement, sum of the forces of each contact, and number of active contacts.

    Args:
        answer: the answer.
        dimension: components of the displacement.
        scene: the scene; None for a model in a file, which has no units.
        problem: its contact problem; None for a model in a file.
        forces: forces of pressures, (c,).
    """
    length = force = ""
    if scene is not None and scene.units is not None:
        length = scene.units.length
        force = scene.units.force_in(scene.hypothesis)
    elif scene is not None and scene.hypothesis.startswith("plane"):
        force = "per unit depth"
    displacement = answer.displacement().reshape(-1, dimension)
    rows = {
        _with_unit("largest displacement", length): float(
            np.linalg.norm(displacement, axis=1).max()
        )
    }
    normal = (
        "normal " if forces.size < answer.forces().size else ""
    )  # there are others, such as friction
    if problem is None or scene is None:
        rows[_with_unit(f"sum of the {normal}forces of all contacts", force)] = float(forces.sum())
    else:
        numbers = [
            number for number in range(len(scene.contacts)) if problem.pressing_of(number).size
        ]
        for number in numbers:
            which = f" {number} of {', '.join(map(str, scene.contacts[number].tags))}"
            several = len(numbers) > 1
            name = (
                f"sum of the {normal}forces of contact{which}"
                if several
                else f"sum of {normal}contact forces"
            )
            rows[_with_unit(name, force)] = float(
                forces @ problem.shares_of(number)[problem.pressing]
            )
    return rows | {"active contacts": int((forces > 0).sum())} | answer.memory.counted()


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _full_of(scene: str) -> FullOrderModel:
    from hhr_dolfinx.command.loading import scene_of
    from hhr_dolfinx.full_order.full import FullOrderModel

    return FullOrderModel(scene_of(scene))


def _checked_answer(full: FullOrderModel, point: dict[str, float], step: StepOptions) -> Answer:
    """Answer of a full model, whose strains are checked once it is there."""
    from hhr_dolfinx.snapshots.records import SnapshotSet

    with full.strains.paused():
        answer = full.solve(point, **step)
    full.strains.check(full, SnapshotSet.of_answers([answer], rows=full.spread))
    return answer


def _meshed(model: AnsweringModel, scene: str | None) -> AnsweringModel:
    """Model with the mesh for the fields of a model in a file: that of a scene, or the model with
    its mesh beside it.

    Raises:
        UsageError: if nothing reads a mesh beside a model.
        NotOfferedError: if no mesh lies beside it.
    """
    if scene is not None:
        return _full_of(scene)
    if model.fields.full is None:
        raise click.UsageError(
            "--out needs a mesh, which a model in a file has not: name the scene, --scene FILE.py"
        )
    model.fields.full.answer_mesh()  # refuses before the point is solved
    return model


@click.command(
    epilog=examples(
        "hhr solve my_scene.py --at load=3", "hhr solve out/my_scene/model.npz --at load=3"
    )
)
@click.argument("what")
@AT
@click.option(
    "--duration",
    type=float,
    help="for laws of bodies with rates: seconds of the one step from rest [1]",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="write fields there, for ParaView (.vtkhdf or .vtu)",
)
@click.option(
    "--scene",
    "meshed_by",
    help="with --out: the scene of a model in a file, for its mesh [that beside the model]",
)
@KNOWN_OPTION
@guarded
def solve(
    what: str,
    words: tuple[str, ...],
    duration: float | None,
    out: Path | None,
    meshed_by: str | None,
    known: tuple[str, ...],
) -> None:
    """Answer one parameter point, by a SCENE in full or by a reduced model from a file (.npz).

    Where bodies have laws, so that answers depend on the path, the answer is that of one step from
    rest. Without --at a scene is solved in the middle of its box.
    """
    from hhr_dolfinx.command.loading import beside, checked_target, is_model, model_of, point_of

    in_file = is_model(what)
    if meshed_by is not None and (out is None or not in_file):
        raise click.UsageError(
            "--scene has the mesh for the --out of a model in a file: leave it out"
        )
    checked_target(out, FIELDS)
    if out is not None:
        write = registry.tool("fields", "--out, a file of fields,")
    model = model_of(what, known) if in_file else _full_of(what)
    meshed = _meshed(model, meshed_by) if in_file and out is not None else model
    scene, problem = (None, None) if in_file else (model.scene, model.problem)
    middle = not (words or in_file)
    point = point_of(words, model.parameters, others=model.parameters.middle if middle else None)
    step: StepOptions = {}
    if model.equilibrium is not None:
        step = {"duration": 1.0 if duration is None else duration}
    elif duration is not None:
        raise click.UsageError("all bodies are elastic: leave out --duration")
    answer = model.solve(point, **step) if in_file else _checked_answer(model, point, step)
    rows = {f"{name}, middle of its box": value for name, value in point.items()} if middle else {}
    rows |= {"seconds of one step from rest": step["duration"]} if step else {}
    rows |= largest_values(answer, model.dimension, scene, problem, model.pressures(answer))
    if model.fields.functionals is not None:
        outputs = answer.outputs()
        rows |= {
            _with_unit(name, outputs.units[name]): value for name, value in outputs.values.items()
        }
    estimate = answer.estimate() if in_file else None
    if estimate is not None:
        rows |= estimate.shown()
    unique = model.uniqueness(point) if model.law.remembers and not step else ""
    if first_rank():
        for name, value in rows.items():
            click.echo(f"{name}: {value:.6g}")
        for name, text in (("path", answer.note), (f"answers with {model.law.name}", unique)):
            if text:
                click.echo(f"{name}: {text}")
        if (
            not in_file
            and "march" in registry.named("commands")
            and beside(what, "PATHS") is not None
        ):
            click.echo(
                f"this is one step from rest: hhr march {what} follows the steps of PATHS in this "
                "file"
            )
    if out is not None:
        written, *_ = write(out, meshed, answer)
        limited = ", as far as the files beside the model have them: --scene FILE.py adds the rest"
        click.echo(f"fields: {written}{limited if meshed is model and in_file else ''}")
