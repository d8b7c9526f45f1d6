"""What makes each picture of the documentation: runs of demos, answers drawn on their scenes, and
pages in a browser. ``pictures.py`` has the table.
"""

import dataclasses
import importlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "out" / "pictures"
os.environ.setdefault("OMP_NUM_THREADS", "1")  # small problems get no faster by more

import numpy as np  # noqa: E402

import hhr_dolfinx as hhr  # noqa: E402

RESOLUTION = 200
"""Dots per inch."""
SCENES: dict[str, tuple[str, tuple[float, ...] | None]] = {
    "fuel_rod": ("scene", None),
    "held_by_contact": ("o_ring", (0.2, 0.02)),
    "hertz_half_discs": ("scene", None),
    "pellet_cladding": ("scene", None),
    "pellet_cladding_nonmatching": ("scene", None),
    "pellet_materials": ("scene", None),
    "press_fit": ("scene", None),
    "sphere_on_block": ("scene", None),
    "your_scene": ("scene", None),
}
"""Function of a script that makes its scene, and the point of the picture; without one the last
point of its ``VIEW``.
"""
_RUN: set[str] = set()
"""Scripts that have run, which may write several pictures."""


def of_run(script: str, file: str, *options: str) -> Path:
    """Run a script at its full size; the picture that it writes.

    Args:
        script: below the root of the checkout.
        file: name of the picture in its folder of results.
        options: further words of the command.
    """
    folder = OUT / Path(script).stem
    command = [sys.executable, str(ROOT / script), *options, "--out", str(folder)]
    if script not in _RUN:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / "said.txt").open("w") as said:
            subprocess.run(command, check=True, stdout=said, stderr=subprocess.STDOUT)
        _RUN.add(script)
    return folder / file


def of_answer(name: str) -> Path:
    """Draw the answer of the full model of a script's scene at one point."""
    module = importlib.import_module(name)
    made, point = SCENES[name]
    scene = _with_units(getattr(module, made)())
    full = hhr.FullOrderModel(scene)
    return _drawn(full.solve(module.VIEW().points[-1] if point is None else point), full, name)


def _with_units(scene: hhr.Scene) -> hhr.Scene:
    """The scene with the units that its page names, if it states none itself."""
    if scene.units is not None:
        return scene
    metres = scene.name == "hertz_half_discs"
    return dataclasses.replace(scene, units=hhr.Units(*(("m", "Pa") if metres else ("mm", "MPa"))))


def _drawn(answer: Any, full: Any, name: str) -> Path:
    """Draw an answer into the folder of results."""
    OUT.mkdir(parents=True, exist_ok=True)
    path = OUT / f"{name}.png"
    answer.plot(path, full=full)
    return path


def of_plastic_pellet() -> Path:
    """Draw the end of the history of a pellet that yields in a cladding that creeps."""
    import pellet_cladding_plastic as demo

    full = hhr.FullOrderModel(_with_units(demo.scene()))
    return _drawn(full.march(demo.path(10.0)).answers[-1], full, "pellet_cladding_plastic")


def of_reduced_pellet() -> Path:
    """Draw the cells on which the reduced pellet integrates, and the stress of both models."""
    import pellet_cladding as demo
    from matplotlib.figure import Figure

    from hhr_dolfinx.materials.elasticity import von_mises
    from hhr_dolfinx.plugins.studies.report import reduced_sizes

    training = hhr.train(demo.scene(), demo.GRID, folder=OUT / "pellet" / "snapshots")
    model = training.build()
    full = training.full_order
    point = demo.VIEW().points[-1]
    stresses = [von_mises(one.solve(point).stress()) for one in (full, model)]
    mesh = full.answer_mesh()
    kept = np.isin(np.arange(len(mesh.cells)), model.offline.sets.cells)
    reduced = reduced_sizes(model)
    sizes = (
        f"full order: {full.sizes[0]} unknowns",
        f"reduced: {reduced['ell_bar']} modes, {reduced['N_lambda_C']} contacts",
    )
    figure = Figure(figsize=(11, 5.6), layout="constrained")
    panels = figure.subplots(1, 3)
    _cells(panels[0], mesh, kept.astype(float), cmap="Reds", vmin=0.0, vmax=1.3)
    panels[0].set_title(f"integrates on {kept.sum()} of {kept.size} cells", fontsize="medium")
    largest = float(np.max(stresses))
    for axes, values, name in zip(panels[1:], stresses, sizes, strict=True):
        drawn = _cells(axes, mesh, values, cmap="viridis", vmin=0.0, vmax=largest)
        axes.set_title(name, fontsize="medium")
    figure.colorbar(drawn, ax=panels[1:], label="von Mises stress [MPa]", aspect=35)
    OUT.mkdir(parents=True, exist_ok=True)
    path = OUT / "pellet.png"
    figure.savefig(path, dpi=RESOLUTION)
    return path


def _cells(axes: Any, mesh: Any, values: np.ndarray, **look: Any) -> Any:
    """Fill quadrilaterals of a section, numbered as VTK does, by one value each."""
    from matplotlib.collections import PolyCollection

    corners = mesh.points[mesh.cells[:, :4]]
    filled = PolyCollection(
        corners, array=values, cmap=look["cmap"], edgecolors="face", linewidths=0.2
    )
    filled.set_clim(look["vmin"], look["vmax"])
    axes.add_collection(filled)
    axes.autoscale_view()
    axes.set(aspect="equal", xlabel="r [mm]", ylabel="z [mm]")
    return filled


def _page(name: str, model: Any, full: Any) -> Path:
    """Write the page of a model."""
    OUT.mkdir(parents=True, exist_ok=True)
    return hhr.write_model_page(OUT / f"{name}.html", model, hhr.scenery_of(full))


READY = "document.documentElement.dataset.converged === 'true'"
"""A page that has answered."""


def _moved(page: Any, parameter: int, values: Any) -> None:
    """Lead one parameter of a page through values, as a hand does."""
    for value in values:
        page.run(
            "(() => { const all = document.querySelectorAll('#sliders input[type=number]'); "
            f"const s = all[{parameter}]; s.value = {float(f'{value:.6g}')!r}; "
            "s.dispatchEvent(new Event('change')); "
            "return new Promise(done => setTimeout(done, 60)); })()"
        )


def _chosen(page: Any, name: str, words: str) -> None:
    """Choose an entry of a list of a page by its words."""
    page.run(
        f"(() => {{ const s = document.getElementById({name!r}); "
        f"s.value = [...s.options].find(o => o.text.includes({words!r})).value; "
        "s.dispatchEvent(new Event('input')); })()"
    )
    page.wait_for(READY)


def _shown(page: Any, path: Path) -> Path:
    """Write a page down to the end of its last picture, without what it says of itself below."""
    page.wait_for(READY)
    script = "document.querySelector('#shape').getBoundingClientRect().bottom + scrollY + 12"
    return page.picture(path, height=page.run(script))


def of_pellet_page() -> Path:
    """Draw the page of the pellet in its cladding."""
    import pellet_cladding as demo
    from browser import Page

    outputs = (
        hhr.LargestPressure("largest pressure", 0, unit="MPa"),
        hhr.ContactForce("force on the pellet", 0, (-1.0, 0.0), unit="N"),
        hhr.ContactArea("pressed area", 0, unit="mm^2"),
    )
    scene = dataclasses.replace(_with_units(demo.scene()), outputs=outputs)
    full = hhr.FullOrderModel(scene)
    file = _page("pellet_page", hhr.condense(full), full)
    with Page() as page:
        page.open(file, "P1=150&h1=4")
        return _shown(page, OUT / "page.png")


def of_friction_page() -> Path:
    """Draw the page of a cylinder that is pressed, and rubbed to and fro."""
    import fretting as demo
    from browser import Page

    full = hhr.FullOrderModel(dataclasses.replace(demo.scene(), outputs=()))
    file = _page("friction_page", hhr.condense(full), full)
    with Page() as page:
        page.open(file, "push=0&shear=0&friction=0.5")
        page.wait_for(READY)
        _chosen(page, "over", "shear")
        _chosen(page, "drawn", "along x")
        _moved(page, 0, np.linspace(0.0, 0.008, 9)[1:])
        turns = [np.linspace(0.0, 0.01, 13), np.linspace(0.01, -0.01, 25)]
        _moved(page, 1, np.concatenate([*turns, np.linspace(-0.01, 0.01, 25)]))
        return _shown(page, OUT / "page_friction.png")


def of_flow_page() -> Path:
    """Draw the page of a sphere that is pressed into a block that yields, and drawn off."""
    import indentation as demo
    from browser import Page

    scene = dataclasses.replace(demo.scene(10), units=hhr.Units("mm", "MPa"))
    own = demo.TRAINED.lower[:3], demo.TRAINED.upper[:3]
    box = hhr.ParameterSpace(("depth", "sy", "H"), *own)
    paths = [demo.path(*values) for values in hhr.Sobol(12).points(box)]
    training = hhr.train(scene, paths)
    file = _page("flow_page", training.condense(), training.full_order)
    with Page() as page:
        page.open(file, "depth=0&sy=150&H=5000")
        page.wait_for(READY)
        _chosen(page, "over", "depth")
        _chosen(page, "drawn", "force")
        _moved(page, 0, [*np.linspace(0.0, 0.028, 15)[1:], *np.linspace(0.028, 0.019, 7)[1:]])
        _chosen(page, "component", "plastic strain")
        return _shown(page, OUT / "page_flow.png")


def of_stress_page() -> Path:
    """Draw von Mises' stress of the page of a sphere on a block."""
    import sphere_on_block as demo
    from browser import Page

    scene = demo.scene(sphere_cells=(14, 7), block_cells=(12, 6))
    full = hhr.FullOrderModel(_with_units(scene))
    file = _page("stress_page", hhr.condense(full), full)
    with Page() as page:
        page.open(file, "push=0.2&squeeze=60")
        page.wait_for(READY)
        _chosen(page, "component", "von Mises")
        return page.picture(OUT / "page_stress.png", part="#shape")


def of_report() -> Path:
    """Draw the beginning of the report of a study."""
    from browser import Page

    # the report is of the small size, which its first line states
    of_run("demos/press_fit.py", "report.html", "--quick")
    with Page() as page:
        page.open(OUT / "press_fit" / "report.html")
        script = "document.querySelector('.charts figure').getBoundingClientRect().bottom + 12"
        return page.picture(OUT / "report.png", height=page.run(script))
