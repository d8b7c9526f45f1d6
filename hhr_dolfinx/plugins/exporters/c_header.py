"""A condensed model as one C header: its arrays, and code that solves the contact problem (C99, libm only).

The arrays are those of a page, see :mod:`hhr_dolfinx.plugins.pages.arrays`; ``kernel.h`` has the code.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from hhr_dolfinx.errors import ModelFileWarning, NotOfferedError
from hhr_dolfinx.files import replacing
from hhr_dolfinx.plugins.pages.arrays import check_model, contact_tree, page_of
from hhr_dolfinx.plugins.pages.packing import Packed
from hhr_dolfinx.warn import warn

MOST_NUMBERS = 4_000_000
"""Most numbers of a header: 80 MB of text, such as S of 2,800 conditions."""
_SIGNS = ("+", "-", "*", "/")
_CALLS = {"^": "pow", "min": "model_min", "max": "model_max", "abs": "fabs"}
"""Operations with another name in C."""


def write_c_header(path: str | Path, model: object) -> Path:
    """Write a condensed model as a C header; its names begin with that of the file.

    Args:
        path: of the header, ``.h``; its stem must be an identifier of C.
        model: of ``hhr.condense``, ``hhr.reduce`` or a file: elastic or condensed inelastic, with friction or without.

    Returns:
        The path.

    Raises:
        NotOfferedError: for any other model, or one that is too large to be compiled.
        FileError: if the file cannot be written.

    Warns:
        ModelFileWarning: if some outputs cannot be computed in C.
    """
    text, _ = c_header(model, Path(path).stem)
    with replacing(path, text=True) as file:
        file.write(text)
    return Path(path)


def c_header(model: Any, name: str) -> tuple[str, dict[str, Any]]:
    """Text of the header, with ``name`` instead of ``model``, and the tree it was made from."""
    if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
        raise NotOfferedError(f"{name!r} is no identifier of C, from which names of the header are made: name it else")
    check_model(model, "a header")
    arrays = Packed()
    tree = contact_tree(model, arrays)
    if tree["flow"]:  # a page may store it with fewer digits
        arrays.put(tree["flow"]["per_force"], model.flow.per_force)
    count = sum(array.size for array in arrays.arrays.values())
    if count > MOST_NUMBERS:
        raise NotOfferedError(
            f"a header of {count} numbers takes a compiler too long, {MOST_NUMBERS} are the most: take a coarser mesh"
        )
    if tree["missing"]:
        warn(
            f"the C header has no output {', '.join(tree['missing'])}: only Python computes outputs that read "
            "displacements if stiffness or shape varies, areas if shapes vary, von Mises' stress, and energies of "
            "heated bodies, of those with laws and of those that contact alone holds",
            ModelFileWarning,
        )
    data = _Data(tree, arrays.arrays)
    text = kernel_file("kernel.h").replace("MODEL_TITLE", name)
    needs = {name: tree[name] for name in ("friction", "floating", "flow")} | {"springs": tree["floating"]}
    for part, needed in needs.items():
        text = text.replace(f"/*{part.upper()}*/", _part(model, part) if needed else "")
    text = text.replace("/*DATA*/", data.text())
    own = {"model_": f"{name}_", "MODEL_": f"{name.upper()}_"}
    # quoted texts are names of the scene
    return re.sub(r'"[^"\n]*"|\b(?:model_|MODEL_)', lambda found: own.get(found[0], found[0]), text), tree


def box_of(tree: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the box, (P,) each: of the parameters, or of the training range within it."""
    lower = np.array(tree["lower"])
    upper = np.array(tree["upper"])
    if tree["trained"] is None:
        return lower, upper
    return np.maximum(lower, tree["trained"][0]), np.minimum(upper, tree["trained"][1])


def _part(model: Any, part: str) -> str:
    """Text of an optional part of the kernel; the plug-in of a law of interfaces has that of the law."""
    if model.law.plugin and (law := page_of(model.law, "a header")).key == part:
        return law.header.read_text("utf-8")
    return (kernel_file("programs.h") if part == "flow" else "") + kernel_file(f"{part}.h")


def kernel_file(name: str) -> str:
    """Text of a C file of this folder."""
    return (resources.files(__package__) / name).read_text(encoding="utf-8")


def formula(steps: list[Any]) -> str:
    """C expression of the parameters ``p``, from operations of ``plugins.pages.packing.steps_of``."""
    stack: list[str] = []
    for step in steps:
        if isinstance(step, float):
            stack.append(f"({step!r})")
        elif isinstance(step, list) and step[0] == "p":
            stack.append(f"p[{step[1]}]")
        elif isinstance(step, list):
            values = stack[-step[1] :]
            del stack[-step[1] :]
            stack.append(f"model_table({step[1]}, (const double[]){{{', '.join(values)}}})")
        elif step in _SIGNS or step in ("^", "min", "max"):
            second = stack.pop()
            first = stack.pop()
            stack.append(f"({first} {step} {second})" if step in _SIGNS else f"{_CALLS[step]}({first}, {second})")
        else:
            only = stack.pop()
            stack.append(f"(-{only})" if step == "neg" else f"{_CALLS.get(step, step)}({only})")
    return stack[0]


class _Data:
    """Arrays, formulas and records of a header."""

    def __init__(self, tree: dict[str, Any], arrays: dict[str, np.ndarray]):
        self.tree = tree
        self.arrays = arrays
        self.parts: list[str] = []
        self.formulas = 0

    def text(self) -> str:
        """All declarations, in an order that C accepts."""
        tree = self.tree
        records = [
            self._records("amplitude", "others", [self._amplitude(item) for item in tree["amplitudes"]["others"]]),
            self._records("limit", "limits", [self._limit(item) for item in tree["limits"]]),
            self._records("part", "parts", [self._component(item) for item in tree["parts"]]),
            self._records("output", "outputs", [self._output(item) for item in tree["outputs"]]),
        ]
        reshaped = self._interpolant(tree["reshaped"]) if tree.get("reshaped") else "{0}"
        pairs = self.arrays[tree["groups"]] if tree["groups"] else np.zeros(tree["m"], dtype=int)
        places = np.unique(pairs, return_inverse=True)[1]
        paths = tree["flow"] or tree["friction"]  # the fixed parameters of flow are those of friction too
        own = [
            *(self._path(paths["fixed"]) if paths else ()),
            *(self._flow(tree["flow"]) if tree["flow"] else ()),
            *(self._friction(tree["friction"]) if tree["friction"] else ()),
            *(self._floating(tree["floating"]) if tree["floating"] else ()),
            self._array("pairs", places),
            self._array("constant", self.arrays[tree["amplitudes"]["constant"]]),
            self._array("slopes", self.arrays[tree["amplitudes"]["slopes"]]),
            self._array("schur", np.zeros(1) if tree["schur"] is None else self.arrays[tree["schur"]]),
            self._array("gaps", self._gaps),
            *records,
            f"static const model_interpolant model_reshaped = {reshaped};",
        ]
        return "\n".join([*self._sizes(places), *self._names(), *self.parts, *own])

    @property
    def _gaps(self) -> np.ndarray:
        """Gaps, or the free slack of a constant S, as terms of θ."""
        tree = self.tree
        return self.arrays[(tree["flow"] or tree)["gaps" if tree["schur"] is None else "free_slack"]]

    def _path(self, fixed: list[int]) -> list[str]:
        """Parameters that are fixed along a path, and the box of its start."""
        ends = {name: np.array(self.tree[name]) for name in ("lower", "upper")}
        own = [self._array(f"box_{name}", values) for name, values in ends.items()]
        return [self._array("fixed", np.array(fixed, dtype=int)), *own]

    def _flow(self, item: dict[str, Any]) -> list[str]:
        same = "per_mode per_force forced given moved modal coupled pressed weights".split()
        names = {name: name for name in same} | {"flow_schur": "schur", "share_of": "parts", "mode_share": "mode_parts"}
        bodies = [self._body(number, group) for number, group in enumerate(item["groups"])]
        moduli = [f"{{{self._function(steps)}}}" for steps in item["moduli"]]
        return [
            *(self._array(name, self.arrays[item[key]]) for name, key in names.items()),
            self._array("middle", np.array(item["middle"], dtype=float)),
            self._records("body", "bodies", bodies),
            "static const model_modulus model_moduli[] = {" + (", ".join(moduli) or "{0}") + "};",
        ]

    def _body(self, number: int, group: dict[str, Any]) -> str:
        functions = ", ".join(self._function(steps) for steps in group["constants"])
        self.parts.append(f"static double (*const model_constants{number}[])(const double *) = {{{functions}}};")
        fields: dict[str, Any] = {"constants": f"model_constants{number}", "constants_count": len(group["constants"])}
        fields |= {key: self._put(group[key]) for key in ("elastic", "compliance")}
        fields |= {"points": group["points"], "law": "0"}
        if group["law"] is not None:
            self.parts.append(f"static const model_program model_program{number} = {self._program(group['law'])};")
            fields["law"] = f"&model_program{number}"
        if grading := group["grading"]:
            fields["grading"] = self._put(grading)
        if places := group["places"]:
            fields |= {"places": self._put(places), "coordinates": self.arrays[places].shape[1]}
        return _record(fields)

    def _program(self, law: dict[str, Any]) -> str:
        arrays = ("rows", "ends", "outputs", "output_ends", "kinds", "numbers", "low", "high")
        fields: dict[str, Any] = {key: self._put(law[key]) for key in arrays}
        fields |= {key: law["sizes"][key] for key in ("unknowns", "memory", "constants")}
        return _record(fields | {"numbers_count": self.arrays[law["numbers"]].size, "limited": int(law["limited"])})

    def _friction(self, item: dict[str, Any]) -> list[str]:
        laws = [f"{{{self._function(one)}, {self._function(other)}}}" for one, other in item["laws"]]
        # index of the first tangential row of each contact, and the end of the last
        along = np.searchsorted(self.arrays[item["owner"]], np.arange(self.arrays[item["normal"]].size + 1))
        rows = {"normal": "normal", "tangential": "tangential", "owner": "owner", "law_of": "law", "twice": "twice"}
        return [
            *(self._array(name, self.arrays[item[key]]) for name, key in rows.items()),
            self._array("along", along),
            self._array("area", self.arrays[item["area"]]),
            self._records("law", "laws", laws),
        ]

    def _floating(self, item: dict[str, Any]) -> list[str]:
        """Contact rows of rigid motions, loads along them, their units, and stiffnesses of springs."""
        of_motions, loads = (self.arrays[item[key]] for key in ("taken", "driving"))
        size = self._softness
        scales = {"units": np.abs(of_motions).max(axis=0), "pushes": (of_motions**2).mean(axis=0)}
        values = {name: size / np.where(scale > 0, scale, 1.0) for name, scale in scales.items()}
        arrays = {"taken": of_motions, "driving": loads} | values
        return [self._array(name, array) for name, array in arrays.items()]

    @property
    def _softness(self) -> float:
        """Mean of the diagonal of S, which is stored by halves."""
        places = np.arange(self.tree["m"])
        return float(np.abs(self.arrays[self.tree["schur"]][places * (places + 3) // 2]).mean() or 1.0)

    def _sizes(self, places: np.ndarray) -> Iterable[str]:
        tree = self.tree
        friction = tree["friction"]
        grids = [*tree["parts"], *([tree["reshaped"]] if tree.get("reshaped") else [])]
        sizes: dict[str, float] = {
            "PARAMETERS": len(tree["names"]),
            "CONDITIONS": tree["m"],
            "OUTPUTS": len(tree["outputs"]),
            "TERMS": self._gaps.shape[1],
            "AFFINE": len(self.arrays[tree["amplitudes"]["constant"]]),
            "OTHERS": len(tree["amplitudes"]["others"]),
            "LIMITS": len(tree["limits"]),
            "PARTS": len(tree["parts"]),
            "GROUPS": int(places.max()) + 1,
            "CONSTANT": int(tree["schur"] is not None),
            "LONGEST": max([1, *(len(self.arrays[grid["weights"]]) for grid in grids)]),
            "NODES": max([1, *(len(grid["nodes"]) for grid in grids)]),
            "RUBS": int(friction is not None),
            "FLOWS": int(tree["flow"] is not None),
            "MOTIONS": self.arrays[tree["floating"]["taken"]].shape[1] if tree["floating"] else 0,
        }
        if tree["floating"]:
            sizes["SOFTNESS"] = self._softness
        if friction is not None:
            rows = {"CONTACTS": "normal", "TANGENTS": "tangential", "TWICE": "twice"}
            sizes |= {name: self.arrays[friction[key]].size for name, key in rows.items()}
        if flow := tree["flow"]:
            modes, size = self.arrays[flow["per_mode"]].shape
            points = self.arrays[flow["parts"]].size
            sizes |= {"MODES": modes, "POINTS": points, "COMPONENTS": size // points, "BODIES": len(flow["groups"])}
            sizes |= {"SHARES": len(self.arrays[flow["schur"]]), "MODULI": len(flow["moduli"])}
            laws = [group["law"] for group in flow["groups"] if group["law"]]
            sizes |= {
                "RATED": int(any(group["rated"] for group in flow["groups"])),
                "MEMORY": max([size // points + 1, *(law["sizes"]["memory"] for law in laws)]),
                "UNKNOWNS": max([2, *(law["sizes"]["unknowns"] for law in laws)]),
                "REGISTERS": max([1, *(law["registers"] for law in laws)]),
                "CONSTANTS": max(len(group["constants"]) for group in flow["groups"]),
            }
        if paths := tree["flow"] or friction:
            sizes["FIXED_COUNT"] = len(paths["fixed"])
        return [f"#define MODEL_{name} {size}" for name, size in sizes.items()]

    def _names(self) -> Iterable[str]:
        tree = self.tree
        lower, upper = box_of(tree)
        words = {
            "parameter_names": tree["names"],
            "output_names": [item["name"] for item in tree["outputs"]],
            "output_units": [item["unit"] for item in tree["outputs"]],
        }
        for name, values in words.items():
            quoted = ", ".join(_quoted(value) for value in values) or "0"
            yield f"static const char *const model_{name}[] = {{{quoted}}};"
        yield self._array("lower", lower)
        yield self._array("upper", upper)

    def _array(self, name: str, values: np.ndarray) -> str:
        whole = values.dtype.kind in "iu"
        numbers = [str(value) if whole else repr(value) for value in values.ravel().tolist()] or ["0"]
        lines = [", ".join(numbers[k : k + 8]) for k in range(0, len(numbers), 8)]
        return f"static const {'int' if whole else 'double'} model_{name}[] = {{\n" + ",\n".join(lines) + "};"

    def _put(self, name: str, values: object = None) -> str:
        """Declare a separate array; returns its name in C."""
        self.parts.append(self._array(name, self.arrays[name] if values is None else np.array(values)))
        return f"model_{name}"

    def _function(self, steps: list[Any] | None) -> str:
        """Declare a function of the parameters; returns its name in C."""
        if steps is None:
            return "0"
        name = f"model_formula{self.formulas}"
        self.formulas += 1
        self.parts.append(f"static double {name}(const double *p) {{ (void)p; return {formula(steps)}; }}")
        return name

    def _records(self, kind: str, name: str, records: list[str]) -> str:
        return f"static const model_{kind} model_{name}[] = {{" + (",\n".join(records) or "{.count = 0}") + "};"

    def _limit(self, item: dict[str, Any]) -> str:
        high = "HUGE_VAL" if item["high"] is None else repr(item["high"])
        return f"{{.value = {self._function(item['steps'])}, .low = {item['low']!r}, .high = {high}}}"

    def _amplitude(self, item: dict[str, Any]) -> str:
        if item["kind"] == "formula":
            return f"{{.value = {self._function(item['steps'])}}}"
        positions = item["positions"]
        slopes = self._put(f"{positions}_slopes", item["slopes"])
        return (
            f"{{.positions = {self._put(positions)}, .slopes = {slopes}, .constant = {item['constant']!r}, "
            f".count = {self.arrays[positions].size}, .degree = {item['degree']}, .extent = {item['extent']}}}"
        )

    def _interpolant(self, item: dict[str, Any]) -> str:
        name = item["levels"].removesuffix("levels")
        rank, grid = self.arrays[item["weights"]].shape
        own: dict[str, object] = {"axes": self._put(f"{name}axes", np.array(item["axes"], dtype=int))}
        own |= {key: self._put(f"{name}{key}", item[key]) for key in ("lower", "upper", "nodes")}
        own |= {key: self._put(item[key]) for key in ("levels", "weights", "modes")}
        own |= {"axes_count": len(item["axes"]), "nodes_count": len(item["nodes"]), "grid": grid, "rank": rank}
        return _record(own)

    def _component(self, item: dict[str, Any]) -> str:
        arrays = ", ".join(f".{key} = {self._put(item[key])}" for key in ("conditions", "terms", "columns"))
        count, terms = (self.arrays[item[key]].size for key in ("conditions", "terms"))
        return (
            f"{{.interpolant = {self._interpolant(item)}, .factor = {self._function(item['factor'])}, {arrays}, "
            f".count = {count}, .terms_count = {terms}, .forced = {item['forced']}}}"
        )

    def _output(self, item: dict[str, Any]) -> str:
        if item["kind"] == "linear":
            names = {key: item[key] for key in ("forces", "terms", "motions") if key in item} | item.get("moved", {})
            return "{" + ", ".join(f".{key} = {self._put(name)}" for key, name in names.items()) + "}"
        if item["kind"] == "quadratic":
            return f"{{.half = {self._put(item['half'])}}}"
        own = f"{{.conditions = {self._put(item['conditions'])}, .areas = {self._put(item['areas'])}, "
        own += f".count = {self.arrays[item['conditions']].size}, "
        if item["kind"] == "largest":
            return own + ".largest = 1}"
        own += f".counted = {self._put(item['counted'])}, "
        return own + f".offset = {item['offset']!r}, .factor = {item['factor']!r}, .least = {item['least']!r}}}"


def _record(fields: dict[str, Any]) -> str:
    """Initialiser of a record in C."""
    return "{" + ", ".join(f".{key} = {value}" for key, value in fields.items()) + "}"


def _quoted(text: str) -> str:
    """C string literal in ASCII; other characters are escapes of their bytes, each ending a literal."""
    found = "".join(
        chr(byte) if 32 <= byte < 127 and chr(byte) not in '"\\?' else f'\\x{byte:02x}""'
        for byte in text.encode(errors="replace")
    )
    return f'"{found}"'
