"""A condensed model as a unit for co-simulation, FMI 3.0 (Modelica Association, 2022).

The archive has a description, the C sources, and a library compiled from them on this machine.
Parameters are inputs; a step is one answer, or one increment.
"""

from __future__ import annotations

import hashlib
import platform
import subprocess
import tempfile
import zipfile
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from hhr_dolfinx.errors import MissingPackageError, NotOfferedError
from hhr_dolfinx.files import replacing
from hhr_dolfinx.plugins.exporters.c_header import OwnHeader, Tree, box_of, c_header
from hhr_dolfinx.timing import today
from hhr_dolfinx.version import __version__

if TYPE_CHECKING:
    from hhr_dolfinx.models.model import KeptModel

IDENTIFIER = "model"
"""Name of the unit's code, and of the prefix of its functions."""
_SYSTEMS = {"Linux": ("linux", ".so"), "Darwin": ("darwin", ".dylib")}
_MACHINES = {"arm64": "aarch64", "AMD64": "x86_64"}


def write_fmu(path: str | Path, model: KeptModel | OwnHeader, compiler: str = "cc") -> Path:
    """Write a condensed model as an FMU.

    Args:
        path: of the archive, ``.fmu``.
        model: of ``hhr.condense``, ``hhr.reduce`` or a file, of a scene with outputs. With friction
            or inelastic bodies, a step is an increment, and moduli and laws are fixed.
        compiler: a C compiler that accepts the options of gcc.

    Returns:
        The path.

    Raises:
        NotOfferedError: for any other model, one without outputs, or on an unsupported system.
        MissingPackageError: without a compiler.
        FileError: if the file cannot be written.
    """
    header, tree = c_header(model, IDENTIFIER)
    _check_names(tree)
    token = hashlib.sha256(header.encode()).hexdigest()[:32]
    sources = {"fmu.c": f'#define MODEL_TOKEN "{token}"\n' + _unit(), "model.h": header}
    system, ending = _system()
    with replacing(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description(tree, Path(path).stem, token))
        archive.writestr("sources/buildDescription.xml", _build_description())
        for name, text in sources.items():
            archive.writestr(f"sources/{name}", text)
        archive.writestr(f"binaries/{system}/{IDENTIFIER}{ending}", _compiled(sources, compiler))
    return Path(path)


def _unit() -> str:
    return (resources.files(__package__) / "fmu.c").read_text(encoding="utf-8")


def _check_names(tree: Tree) -> None:
    """Raise NotOfferedError if there is no output, or if names are not valid in FMI."""
    if not tree["outputs"]:
        reason = (
            f": {', '.join(tree['missing'])} are read in Python alone" if tree["missing"] else ""
        )
        raise NotOfferedError(
            f"a unit hands out numbers, and this model has no outputs for it{reason}. Name some in "
            "Scene(..., outputs=...)"
        )
    names = ["time", *tree["names"], *(output["name"] for output in tree["outputs"])]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise NotOfferedError(
            f"variables of a unit need different names, and {twice} are there twice: rename them"
        )
    words = names + [output["unit"] for output in tree["outputs"]]
    if odd := [word for word in words if word and not word.isprintable()]:
        raise NotOfferedError(f"names of a unit are printed, and {odd} cannot be: rename them")


def description(tree: Tree, name: str, token: str) -> bytes:
    """Content of ``modelDescription.xml``.

    Args:
        tree: numbers and names of the model.
        name: name of the model.
        token: token that identifies the header.
    """
    lower, upper = (ends.tolist() for ends in box_of(tree))
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=name,
        instantiationToken=token,
        generationTool=f"hhr_dolfinx {__version__}",
        description=f"A contact problem, condensed to {tree['m']} conditions; made {today()}",
    )
    path = tree["path"]
    ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=IDENTIFIER,
        canHandleVariableCommunicationStepSize="true",
        providesDirectionalDerivatives="false" if path else "true",
    )
    if units := dict.fromkeys(quantity["unit"] for quantity in tree["outputs"] if quantity["unit"]):
        defined = ElementTree.SubElement(root, "UnitDefinitions")
        for unit in units:
            ElementTree.SubElement(defined, "Unit", name=unit)
    variables = ElementTree.SubElement(root, "ModelVariables")
    _variable(variables, "time", 0, "independent")
    for k, parameter in enumerate(tree["names"]):
        words = {
            "min": repr(lower[k]),
            "max": repr(upper[k]),
            "start": repr((lower[k] + upper[k]) / 2),
        }
        stays = path is not None and k in path["fixed"]
        _variable(variables, parameter, 1 + k, "parameter" if stays else "input", **words)
    first = 1 + len(tree["names"])
    structure = ElementTree.SubElement(root, "ModelStructure")
    for kind in ("Output", "InitialUnknown"):
        for k in range(len(tree["outputs"])):
            # on a path outputs belong to the last step, and do not depend on the inputs
            ways = range(1, 1 if path and kind == "Output" else first)
            inputs = " ".join(str(reference) for reference in ways)
            ElementTree.SubElement(
                structure, kind, valueReference=str(first + k), dependencies=inputs
            )
    for k, output in enumerate(tree["outputs"]):
        words = {"unit": output["unit"]} if output["unit"] else {}
        _variable(variables, output["name"], first + k, "output", **words)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _variable(
    parent: ElementTree.Element, name: str, reference: int, causality: str, **words: str
) -> None:
    variability = "fixed" if causality == "parameter" else "continuous"
    attributes = {
        "name": name,
        "valueReference": str(reference),
        "causality": causality,
        "variability": variability,
    }
    ElementTree.SubElement(parent, "Float64", {**attributes, **words})


def _build_description() -> bytes:
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=IDENTIFIER)
    files = ElementTree.SubElement(configuration, "SourceFileSet", language="C99")
    ElementTree.SubElement(files, "SourceFile", name="fmu.c")
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _system() -> tuple[str, str]:
    """Folder of the binaries of this machine, and the suffix of their names."""
    if platform.system() not in _SYSTEMS:
        raise NotOfferedError(
            f"units are compiled on {', '.join(_SYSTEMS)}, and this is {platform.system()}"
        )
    name, ending = _SYSTEMS[platform.system()]
    return f"{_MACHINES.get(platform.machine(), platform.machine())}-{name}", ending


def _compiled(sources: dict[str, str], compiler: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        words = [
            compiler,
            "-std=c99",
            "-O2",
            "-shared",
            "-fPIC",
            "-fvisibility=hidden",
            "-o",
            "unit",
            "fmu.c",
            "-lm",
        ]
        try:
            subprocess.run(words, cwd=folder, check=True, capture_output=True, text=True)
        except FileNotFoundError:
            raise MissingPackageError(
                f"a unit is compiled, and there is no compiler {compiler!r}: install one, or name "
                "it"
            ) from None
        except subprocess.CalledProcessError as error:
            raise NotOfferedError(
                f"{compiler} does not compile the unit: {error.stderr[:500]}"
            ) from error
        return (Path(folder) / "unit").read_bytes()
