"""Data of the C kernel for one model, in a header or on a page: sizes, arrays and records of
``c/kernel.h``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from hhr_dolfinx.plugins.pages.packing import Steps

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

Data: TypeAlias = "Struct | list[Struct] | np.ndarray | str | None"
"""Records and arrays of a kernel; a text is the name of an array."""
Field: TypeAlias = (
    "RecordedFormula | Struct | list[RecordedFormula] | np.ndarray | str | float | None"
)
"""Field of a record; a text is the name of an array."""


@dataclass(frozen=True)
class RecordedFormula:
    """Function of the parameters; None without one."""

    steps: Steps | None


@dataclass(frozen=True)
class Struct:
    """Struct of the type ``model_KIND``; fields that are missing are zero."""

    kind: str
    fields: Mapping[str, Any]


@dataclass(frozen=True)
class KernelData:
    """Sizes by their names, and arrays and records by theirs."""

    sizes: dict[str, int | float]
    data: dict[str, Data]


def kernel_data(
    tree: dict[str, Any],
    arrays: dict[str, np.ndarray],
    ends: tuple[ArrayLike, ArrayLike],
) -> KernelData:
    """Data of a model from its tree and arrays, see :mod:`hhr_dolfinx.plugins.pages.arrays`.

    Args:
        tree: from ``contact_tree``.
        arrays: by name.
        ends: smallest and largest parameters with answers, (P,) each.
    """
    return _RecordReader(tree, arrays).kernel_data(ends)


class _RecordReader:
    def __init__(self, tree: dict[str, Any], arrays: dict[str, np.ndarray]):
        self.tree = tree
        self.arrays = arrays

    def kernel_data(self, ends: tuple[ArrayLike, ArrayLike]) -> KernelData:
        tree = self.tree
        groups = self.arrays[tree["groups"]] if tree["groups"] else np.zeros(tree["m"], dtype=int)
        group_of_rows = np.unique(groups, return_inverse=True)[1]
        data: dict[str, Data] = {
            "lower": np.array(ends[0], dtype=float),
            "upper": np.array(ends[1], dtype=float),
            "pairs": group_of_rows,
            "constant": tree["amplitudes"]["constant"],
            "slopes": tree["amplitudes"]["slopes"],
            "schur": tree["schur"],
            "gaps": self._gaps,
            "others": [self._amplitude(entry) for entry in tree["amplitudes"]["others"]],
            "limits": [self._limit(entry) for entry in tree["limits"]],
            "parts": [self._component(entry) for entry in tree["parts"]],
            "outputs": [self._output(entry) for entry in tree["outputs"]],
            "reshaped": self._interpolant(tree["reshaped"])
            if tree.get("reshaped")
            else Struct("interpolant", {}),
        }
        readers = {
            "path": self._path,
            "flow": self._flow,
            "friction": self._friction,
            "floating": self._floating,
        }
        for key, read in (readers | {"ranges": self._ranges}).items():
            data |= read(tree[key]) if tree[key] else {}
        return KernelData(self._sizes(group_of_rows), data)

    @property
    def _gaps(self) -> str:
        """Gaps, or the free slack of a constant S, as terms of θ."""
        tree = self.tree
        name: str = (tree["flow"] or tree)["gaps" if tree["schur"] is None else "free_slack"]
        return name

    def _path(self, item: dict[str, Any]) -> Mapping[str, Data]:
        """Parameters that are fixed along a path, and the box of its start."""
        ends = {f"box_{name}": np.array(self.tree[name]) for name in ("lower", "upper")}
        return {"fixed": np.array(item["fixed"], dtype=int)} | ends

    def _ranges(self, item: dict[str, Any]) -> Mapping[str, Data]:
        """Laws of plug-ins, each on its conditions."""
        ranges = []
        formulas = first = 0
        for law_range in item["items"]:
            rows = self.arrays[law_range["rows"]]
            width = self.arrays[law_range["numbers"]].shape[1]
            fields = {
                key: law_range[key] for key in ("rows", "numbers", "law", "memory", "remembers")
            }
            fields |= {
                "formulas": [RecordedFormula(steps) for steps in law_range["formulas"]] or None,
                "first_formula": formulas,
            }
            fields |= {
                "count": rows.size,
                "width": width,
                "formulas_count": len(law_range["formulas"]),
                "first": first,
            }
            ranges.append(Struct("range", fields))
            formulas += len(law_range["formulas"])
            first += rows.size * law_range["memory"]
        return {"ranges": ranges}

    def _flow(self, item: dict[str, Any]) -> Mapping[str, Data]:
        same = "per_mode per_force forced given moved modal coupled pressed weights".split()
        names = {name: name for name in same} | {
            "flow_schur": "schur",
            "share_of": "parts",
            "mode_share": "mode_parts",
        }
        return {name: item[key] for name, key in names.items()} | {
            "middle": np.array(item["middle"], dtype=float),
            "bodies": [self._body(group) for group in item["groups"]],
            "moduli": [
                Struct("modulus", {"value": RecordedFormula(steps)}) for steps in item["moduli"]
            ],
        }

    def _body(self, group: dict[str, Any]) -> Struct:
        fields: dict[str, Field] = {
            key: group[key] for key in ("elastic", "compliance", "points", "grading")
        }
        fields |= {"constants": [RecordedFormula(steps) for steps in group["constants"]]}
        fields |= {"constants_count": len(group["constants"])}
        fields["law"] = None if group["law"] is None else self._program(group["law"])
        if name := group["places"]:
            fields |= {"places": name, "coordinates": self.arrays[name].shape[1]}
        return Struct("body", fields)

    def _program(self, law: dict[str, Any]) -> Struct:
        arrays = ("rows", "ends", "outputs", "output_ends", "kinds", "numbers", "low", "high")
        fields: dict[str, Field] = {key: law[key] for key in arrays}
        fields |= {key: law["sizes"][key] for key in ("unknowns", "memory", "constants")}
        fields |= {
            "numbers_count": self.arrays[law["numbers"]].size,
            "limited": int(law["limited"]),
        }
        return Struct("program", fields)

    def _friction(self, item: dict[str, Any]) -> Mapping[str, Data]:
        # index of the first tangential row of each contact, and the end of the last
        along = np.searchsorted(
            self.arrays[item["owner"]], np.arange(self.arrays[item["normal"]].size + 1)
        )
        rows = {
            "normal": "normal",
            "tangential": "tangential",
            "owner": "owner",
            "law_of": "law",
            "twice": "twice",
        }
        laws = [
            {"coefficient": RecordedFormula(coefficient), "limit": RecordedFormula(limit)}
            for coefficient, limit in item["laws"]
        ]
        return {name: item[key] for name, key in rows.items()} | {
            "along": along,
            "area": item["area"],
            "laws": [Struct("law", fields) for fields in laws],
        }

    def _floating(self, item: dict[str, Any]) -> Mapping[str, Data]:
        """Contact rows of rigid motions, loads along them, their units, and stiffnesses of
        springs.
        """
        contact_of_motions = self.arrays[item["taken"]]
        scales = {
            "units": np.abs(contact_of_motions).max(axis=0),
            "pushes": (contact_of_motions**2).mean(axis=0),
        }
        values = {
            name: self._softness / np.where(scale > 0, scale, 1.0) for name, scale in scales.items()
        }
        return {"taken": item["taken"], "driving": item["driving"]} | values

    @property
    def _softness(self) -> float:
        """Mean of the diagonal of S, which is stored by halves."""
        indices = np.arange(self.tree["m"])
        flow = self.tree["flow"]
        half = (
            self.arrays[self.tree["schur"]]
            if flow is None
            else self.arrays[flow["schur"]].sum(axis=0)
        )
        return float(np.abs(half[indices * (indices + 3) // 2]).mean() or 1.0)

    def _sizes(self, places: np.ndarray) -> dict[str, int | float]:
        tree = self.tree
        friction = tree["friction"]
        floating = tree["floating"]
        grids = [*tree["parts"], *([tree["reshaped"]] if tree.get("reshaped") else [])]
        sizes: dict[str, int | float] = {
            "PARAMETERS": len(tree["names"]),
            "CONDITIONS": tree["m"],
            "OUTPUTS": len(tree["outputs"]),
            "TERMS": self.arrays[self._gaps].shape[1],
            "AFFINE": len(self.arrays[tree["amplitudes"]["constant"]]),
            "OTHERS": len(tree["amplitudes"]["others"]),
            "LIMITS": len(tree["limits"]),
            "PARTS": len(tree["parts"]),
            "GROUPS": int(places.max()) + 1,
            "CONSTANT": int(tree["schur"] is not None),
            "LONGEST": max([1, *(len(self.arrays[grid["weights"]]) for grid in grids)]),
            "NODES": max([1, *(len(grid["nodes"]) for grid in grids)]),
            "MOTIONS": self.arrays[floating["taken"]].shape[1] if floating else 0,
        }
        if floating:
            sizes["SOFTNESS"] = self._softness
        if friction is not None:
            rows = {"CONTACTS": "normal", "TANGENTS": "tangential", "TWICE": "twice"}
            sizes |= {name: self.arrays[friction[key]].size for name, key in rows.items()}
        if tree["flow"]:
            sizes |= self._sizes_of_flow(tree["flow"])
        if tree["path"]:
            sizes["FIXED_COUNT"] = len(tree["path"]["fixed"])
        if ranges := tree["ranges"]:
            sizes |= {"RANGES": len(ranges["items"]), "RATED": int(ranges["remembers"])}
            sizes["FORMULAS"] = sum(len(law_range["formulas"]) for law_range in ranges["items"])
            counts = (
                self.arrays[law_range["rows"]].size * law_range["memory"]
                for law_range in ranges["items"]
            )
            sizes["REMEMBERED"] = sum(counts)
        return sizes

    def _sizes_of_flow(self, flow: dict[str, Any]) -> dict[str, int]:
        modes, size = self.arrays[flow["per_mode"]].shape
        points = self.arrays[flow["parts"]].size
        laws = [group["law"] for group in flow["groups"] if group["law"]]
        return {
            "MODES": modes,
            "POINTS": points,
            "COMPONENTS": size // points,
            "BODIES": len(flow["groups"]),
            "SHARES": len(self.arrays[flow["schur"]]),
            "MODULI": len(flow["moduli"]),
            "RATED": int(any(group["rated"] for group in flow["groups"])),
            "MEMORY": max([size // points + 1, *(law["sizes"]["memory"] for law in laws)]),
            "UNKNOWNS": max([2, *(law["sizes"]["unknowns"] for law in laws)]),
            "REGISTERS": max([1, *(law["registers"] for law in laws)]),
            "CONSTANTS": max(len(group["constants"]) for group in flow["groups"]),
        }

    def _limit(self, item: dict[str, Any]) -> Struct:
        high = np.inf if item["high"] is None else item["high"]
        return Struct(
            "limit", {"value": RecordedFormula(item["steps"]), "low": item["low"], "high": high}
        )

    def _amplitude(self, item: dict[str, Any]) -> Struct:
        if item["kind"] == "formula":
            return Struct("amplitude", {"value": RecordedFormula(item["steps"])})
        fields = {key: item[key] for key in ("positions", "constant", "degree", "extent")}
        fields |= {
            "slopes": np.array(item["slopes"], dtype=float),
            "count": self.arrays[item["positions"]].size,
        }
        return Struct("amplitude", fields)

    def _interpolant(self, item: dict[str, Any]) -> Struct:
        rank, grid = self.arrays[item["weights"]].shape
        fields: dict[str, Field] = {
            key: np.array(item[key], dtype=float) for key in ("lower", "upper", "nodes")
        }
        fields |= {"axes": np.array(item["axes"], dtype=int)} | {
            key: item[key] for key in ("levels", "weights", "modes")
        }
        fields |= {
            "axes_count": len(item["axes"]),
            "nodes_count": len(item["nodes"]),
            "grid": grid,
            "rank": rank,
        }
        return Struct("interpolant", fields)

    def _component(self, item: dict[str, Any]) -> Struct:
        fields = {key: item[key] for key in ("conditions", "terms", "columns", "forced")}
        count, terms = (self.arrays[item[key]].size for key in ("conditions", "terms"))
        fields |= {
            "interpolant": self._interpolant(item),
            "factor": RecordedFormula(item["factor"]),
        }
        return Struct("part", fields | {"count": count, "terms_count": terms})

    def _output(self, item: dict[str, Any]) -> Struct:
        if item["kind"] == "linear":
            names = {key: item[key] for key in ("forces", "terms", "motions") if key in item}
            return Struct("output", names | item.get("moved", {}))
        if item["kind"] == "quadratic":
            return Struct("output", {"half": item["half"]})
        if item["kind"] == "stress":
            given = ("stressed", "shares", "principal", "components", "count")
            return Struct("output", {key: item[key] for key in given if key in item})
        fields = {"conditions": item["conditions"], "areas": item["areas"]}
        fields |= {"count": self.arrays[item["conditions"]].size}
        if item["kind"] == "largest":
            return Struct("output", fields | {"largest": 1})
        return Struct(
            "output", fields | {key: item[key] for key in ("counted", "offset", "factor", "least")}
        )
