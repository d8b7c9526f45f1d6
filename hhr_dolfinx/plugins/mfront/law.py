"""A behaviour of MFront as a law of a body, by the bindings of MGIS for Python (Helfer et al. 2020,
doi 10.21105/joss.02003). Tensors have the same components in both, (xx, yy, zz, √2 xy[, √2 xz, √2
yz]).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np

from hhr_dolfinx.errors import MissingPackageError, SceneError
from hhr_dolfinx.plugins.inelastic.outside import LawStep, OutsideLaw

START = MappingProxyType({"Temperature": 293.15})
"""External state variables at the start of a history; others start at 0."""
OF_THE_BODY = MappingProxyType({"YoungModulus": "young", "PoissonRatio": "poisson"})
"""Material properties that are E and ν of the body unless they are given."""
NONE: Mapping[str, float | str] = MappingProxyType({})


class MFront(OutsideLaw):
    """A behaviour for small strains of a library that ``mfront --interface=generic`` compiled.

    In the plane and in axisymmetry it is that of plane strain; an orthotropic one has the axes of
    the mesh. External state variables change in a step from their value at the end of the one
    before, :data:`START` at first.

    Args:
        library: path of the library, ``src/libBehaviour.so``.
        behaviour: name of the behaviour.
        constants: material properties and external state variables by name, numbers or formulas of
            the parameters; by default :data:`OF_THE_BODY` are those of the body, and external state
            variables keep their start.
        rated: whether the behaviour depends on the duration of a step.
    """

    def __init__(
        self,
        library: str | Path,
        behaviour: str,
        constants: Mapping[str, float | str] = NONE,
        *,
        rated: bool = True,
    ):
        path = Path(library)
        self.library = str(library)
        # another file of this name is another law
        content = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else self.library
        super().__init__(behaviour, constants, rated, content)

    def memory_of(self, strains: int) -> dict[str, int]:
        """See :class:`OutsideLaw`.

        Raises:
            SceneError: for constants that are missing or unknown.
        """
        mgis, behaviour = _loaded(self.library, self.name, strains)
        needed, external = (
            [variable.name for variable in kind] for kind in (behaviour.mps, behaviour.esvs)
        )
        missing = sorted({*needed} - {*self.constants(), *OF_THE_BODY})
        unknown = sorted({*self.constants()} - {*needed, *external})
        if missing or unknown:
            raise SceneError(
                f"{self.name} has the material properties {needed} and the external state "
                f"variables {external}: {missing} are missing in its constants, and {unknown} are "
                "unknown"
            )
        return {
            "internal": mgis.getArraySize(behaviour.isvs, behaviour.hypothesis)
        } | dict.fromkeys(external, 1)

    def evaluate(
        self, step: LawStep
    ) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray | None]:
        """See :class:`OutsideLaw`; a point fails if MGIS returns a negative number."""
        points, strains = step.strain.shape
        mgis, behaviour = _loaded(self.library, self.name, strains)
        data = mgis.MaterialDataManager(behaviour, points)
        local = mgis.MaterialStateManagerStorageMode.LocalStorage
        values = {name: step.constants[ours] for name, ours in OF_THE_BODY.items()} | {
            **START,
            **step.constants,
        }
        memory = {}
        for name in (variable.name for variable in behaviour.esvs):
            start = START.get(name, 0.0)
            memory[name] = np.full(points, values.get(name, start)) - start
            for state, change in ((data.s0, step.old[name]), (data.s1, memory[name])):
                mgis.setExternalStateVariable(state, name, start + change, local)
        internal = step.old["internal"].reshape(points, -1)
        for state, strain in ((data.s0, step.old["strain"]), (data.s1, step.strain)):
            for name in (variable.name for variable in behaviour.mps):
                mgis.setMaterialProperty(state, name, np.full(points, values[name]), local)
            state.gradients[:] = strain
            state.thermodynamic_forces[:] = step.old["stress"]
            if internal.size:  # the bindings have no array without columns
                state.internal_state_variables[:] = internal
        kinds = "IntegrationWithoutTangentOperator", "IntegrationWithConsistentTangentOperator"
        kind = getattr(mgis.IntegrationType, kinds[step.tangent])
        failed = np.zeros((points, 1), dtype=bool)
        if (
            mgis.integrate(data, kind, step.dt, 0, points) < 0
        ):  # it ends at the first point that fails
            failed[:, 0] = [
                mgis.integrate(data, kind, step.dt, k, k + 1) < 0 for k in range(points)
            ]
        # copies, as these arrays are memory of the manager
        memory["internal"] = data.s1.internal_state_variables.copy() if internal.size else internal
        return (
            np.where(failed, np.nan, data.s1.thermodynamic_forces),
            memory,
            data.K.copy() if step.tangent else None,
        )


@cache
def _loaded(library: str, name: str, strains: int):
    """MGIS, and a behaviour for strains of 4 or 6 components.

    SceneError for those that are no law of a body.
    """
    try:
        import mgis.behaviour as mgis
    except ModuleNotFoundError as error:
        raise MissingPackageError(
            "a law of MFront needs mgis.behaviour, the bindings of MGIS for Python, which are not "
            "installed and are no package of pip: `conda install -c conda-forge mgis`, `spack "
            "install mgis`, or build them"
        ) from error
    hypothesis = mgis.Hypothesis.Tridimensional if strains == 6 else mgis.Hypothesis.PlaneStrain
    try:
        behaviour = mgis.load(library, name, hypothesis)
    except RuntimeError as error:
        raise SceneError(
            f"MGIS cannot load {name} of {library} for {hypothesis}: {error}"
        ) from error
    sizes = {mgis.getVariableSize(variable, hypothesis) for variable in behaviour.esvs}
    if behaviour.getBehaviourType() != "StandardStrainBasedBehaviour" or sizes - {1}:
        raise SceneError(
            f"{name} of {library} must be of small strains, with numbers as external state "
            "variables"
        )
    return mgis, behaviour
