"""Samples of PLAID of the data set that ``data_set.py`` has made (F. Casenave et al.,
arXiv:2505.02974).

It reads the ``.npz`` of each scene and writes ``SCENE/plaid`` beside them: training samples with
parameters, forces and displacements, at each time of a path, and test samples with parameters
alone. It needs NumPy and ``pip install pyplaid``, best in an environment of their own: its HDF5 may
be another one than that of netCDF4.

    python scripts/plaid_samples.py DIR
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np


def samples_of(folder: Path) -> tuple[Any, dict[str, list[tuple[np.ndarray, int]]]]:
    """Maker of the samples of a scene, and their parameters with the number of the answer.

    Args:
        folder: folder of the scene.
    """
    import json

    from plaid import Sample

    with np.load(folder / "problem.npz") as file:
        points = file["points"]
        names = json.loads(file["header"].item())["parameters"]
    with np.load(folder / "training.npz") as file:
        known, forces, fields = (file[name] for name in ("asked", "forces", "fields"))
    with np.load(folder / "test_points.npz") as file:
        hidden = file["asked"]
    dim = points.shape[1]

    def made(entry: tuple[np.ndarray, int]) -> Any:
        row, number = entry
        of_path = row.ndim == 2
        sample = Sample()
        for step, values in enumerate(row[1:] if of_path else [np.concatenate([[0.0], row])]):
            time = float(values[0])
            at_mesh = {"base": "body", "time": time}
            sample.init_base(dim, dim, **at_mesh)
            sample.init_zone(np.array([[len(points), 0, 0]]), zone="mesh", **at_mesh)
            sample.set_nodes(points, zone="mesh", **at_mesh)
            for name, value in zip(names, values[1:], strict=True):
                sample.add_global(name, value, time=time)
            if number < 0:
                continue
            at = (number, step) if of_path else number
            sample.add_global("contact_forces", forces[at], time=time)
            columns = fields[at].astype(float).reshape(len(points), -1).T
            for component, column in zip("xyz", columns, strict=False):
                sample.add_field(f"displacement_{component}", column, zone="mesh", **at_mesh)
        return sample

    return made, {
        "train": [(row, number) for number, row in enumerate(known)],
        "test": [(row, -1) for row in hidden],
    }


def main() -> None:
    """Write the samples of all scenes of a folder."""
    from plaid import Infos
    from plaid.storage import save_to_disk

    if len(sys.argv) != 2:
        sys.exit(__doc__)
    for folder in sorted(Path(sys.argv[1]).glob("*/problem.npz")):
        made, ids = samples_of(folder.parent)
        infos = Infos(owner="hhr_dolfinx", license="LGPL-3.0-or-later")
        save_to_disk(
            folder.parent / "plaid", made, ids, infos=infos, backend="cgns", overwrite=True
        )
        print(
            f"{folder.parent.name}: {len(ids['train'])} training, {len(ids['test'])} test samples"
        )


if __name__ == "__main__":
    main()
