"""The part of ``mgis.behaviour`` that laws use, with the names, shapes and refusals of MGIS 3 by
its sources.

``bindings/python/src`` and ``src`` of MFrontGenericInterfaceSupport. Arrays belong to their manager
and end with it; those without columns cannot be had; integration ends at the first point that
fails; constants are set by name.
"""

import types
from enum import Enum

import numpy as np
from outside_laws import von_mises

Hypothesis = Enum("Hypothesis", ["Tridimensional", "PlaneStrain", "PlaneStress", "Axisymmetrical"])
IntegrationType = Enum(
    "IntegrationType",
    [
        "IntegrationWithoutTangentOperator",
        "IntegrationWithElasticOperator",
        "IntegrationWithConsistentTangentOperator",
    ],
)
MaterialStateManagerStorageMode = Enum(
    "MaterialStateManagerStorageMode", ["LocalStorage", "ExternalStorage"]
)
VariableType = Enum("VariableType", ["SCALAR", "STENSOR", "TENSOR"])
EXPANSION = 1e-5
LARGEST = 0.03
"""Largest change of a component of the strain in a step of the plasticity; beyond it a point
fails.
"""


class Variable:
    def __init__(self, name, kind=VariableType.SCALAR):
        self.name = name
        self.type = kind


def getVariableSize(variable, hypothesis):
    space = hypothesis is Hypothesis.Tridimensional
    return {
        VariableType.SCALAR: 1,
        VariableType.STENSOR: 6 if space else 4,
        VariableType.TENSOR: 9 if space else 5,
    }[variable.type]


def getArraySize(variables, hypothesis):
    return sum(getVariableSize(variable, hypothesis) for variable in variables)


class Behaviour:
    def __init__(
        self, hypothesis, properties, internal, external, point, kind="StandardStrainBasedBehaviour"
    ):
        self.hypothesis = hypothesis
        self.mps = self.material_properties = [Variable(name) for name in properties]
        self.isvs = self.internal_state_variables = internal
        self.esvs = self.external_state_variables = [Variable("Temperature"), *external]
        self.point = point
        self._kind = kind

    def getBehaviourType(self):
        return self._kind


def _plasticity(data, i, dt, tangent):
    """Linear hardening with heat, by the increments of strain and temperature."""
    young, poisson, slope, strength = (data.s1.values(name, i) for name in PLASTIC)
    size = data.s1.gradients.shape[1]
    step = data.s1.gradients[i] - data.s0.gradients[i]
    if not np.abs(step).max() < LARGEST:
        return -1
    step[:3] -= EXPANSION * (data.s1.values("Temperature", i) - data.s0.values("Temperature", i))
    inside = data.s0.internal_state_variables[i]
    bulk, mu = young / (3 - 6 * poisson), young / (2 + 2 * poisson)
    given = {"young": young, "poisson": poisson, "yield_stress": strength, "hardening": slope}
    tangents, stress, amount = von_mises(
        step, data.s0.thermodynamic_forces[i], inside[size], **given
    )
    data.s1.thermodynamic_forces[i] = stress
    mean = stress[:3].mean()
    strain = stress / (2 * mu)
    strain[:3] += mean * (1 / (3 * bulk) - 1 / (2 * mu))
    data.s1.internal_state_variables[i] = [*strain, inside[size] + amount]
    if tangent:
        data.K[i] = tangents
    return 1


def _elasticity(data, i, dt, tangent):
    young, poisson = (data.s1.values(name, i) for name in PLASTIC[:2])
    strain = data.s1.gradients[i]
    none = {"young": young, "poisson": poisson, "yield_stress": np.inf, "hardening": 0.0}
    tangents, data.s1.thermodynamic_forces[i], _ = von_mises(
        strain, np.zeros_like(strain), np.zeros(()), **none
    )
    if tangent:
        data.K[i] = tangents
    return 0  # it succeeds, and is not reliable


PLASTIC = "YoungModulus", "PoissonRatio", "HardeningSlope", "YieldStress"
INTERNAL = [Variable("ElasticStrain", VariableType.STENSOR), Variable("EquivalentPlasticStrain")]


def load(library, name, hypothesis):
    if not isinstance(library, str) or "Behaviour" not in library:
        raise RuntimeError(
            f"LibrariesManager::loadLibrary: library '{library}' could not be loaded"
        )
    made = {
        "Plasticity": lambda: Behaviour(hypothesis, PLASTIC, INTERNAL, [], _plasticity),
        "Elasticity": lambda: Behaviour(hypothesis, PLASTIC[:2], [], [], _elasticity),
        "Finite": lambda: Behaviour(hypothesis, [], [], [], None, "StandardFiniteStrainBehaviour"),
        "Tensorial": lambda: Behaviour(
            hypothesis, [], [], [Variable("Field", VariableType.STENSOR)], None
        ),
    }
    if name not in made:
        raise RuntimeError(f"LibrariesManager::extract: could not load symbol '{name}_mfront_mkt'")
    return made[name]()


class MaterialStateManager:
    def __init__(self, behaviour, n):
        self.n = n
        self._known = {
            "mps": [v.name for v in behaviour.mps],
            "esvs": [v.name for v in behaviour.esvs],
        }
        self._fields = {}
        size = 6 if behaviour.hypothesis is Hypothesis.Tridimensional else 4
        self.gradients = np.zeros((n, size))
        self.thermodynamic_forces = np.zeros((n, size))
        self._internal = np.zeros((n, getArraySize(behaviour.isvs, behaviour.hypothesis)))

    @property
    def internal_state_variables(self):
        if not self._internal.shape[1]:
            raise FloatingPointError("a division by the number of columns, which ends the process")
        return self._internal

    def values(self, name, i):
        """Value at a point; an error without one, as the behaviour reads all of its variables."""
        return self._fields[name][i]

    def set(self, kind, name, value, mode):
        if (
            name not in self._known[kind]
            or mode is not MaterialStateManagerStorageMode.LocalStorage
        ):
            raise RuntimeError(f"getVariable: no variable named '{name}'")
        value = np.asarray(value)
        if value.shape != (self.n,) or value.dtype != float:
            raise RuntimeError(
                "invalid number of values (does not match the number of integration points)"
            )
        self._fields[name] = value.copy()


def setMaterialProperty(state, name, value, mode):
    state.set("mps", name, value, mode)


def setExternalStateVariable(state, name, value, mode):
    state.set("esvs", name, value, mode)


class MaterialDataManager:
    def __init__(self, behaviour, n):
        self.b = behaviour
        self.n = n
        self.s0 = MaterialStateManager(behaviour, n)
        self.s1 = MaterialStateManager(behaviour, n)
        self.K = np.zeros((0, 0, 0))

    def __del__(self):
        """Memory that is freed holds anything."""
        for array in (self.K, self.s1.thermodynamic_forces, self.s1._internal):
            array[:] = np.nan


def integrate(data, kind, dt, first, end):
    if not isinstance(kind, IntegrationType) or not isinstance(dt, float):
        raise TypeError("integrate(): incompatible function arguments")
    tangent = kind is IntegrationType.IntegrationWithConsistentTangentOperator
    size = data.s1.gradients.shape[1]
    if tangent and not data.K.size:
        data.K = np.zeros((data.n, size, size))
    worst = 1
    for i in range(first, end):
        worst = min(worst, data.b.point(data, i, dt, tangent))
        if worst < 0:
            break
    return worst


def installed(modules):
    """Put it into modules as ``mgis.behaviour``."""
    package = types.ModuleType("mgis")
    package.behaviour = behaviour = types.ModuleType("mgis.behaviour")
    vars(behaviour).update(
        {name: value for name, value in globals().items() if not name.startswith("_")}
    )
    modules.update({"mgis": package, "mgis.behaviour": behaviour})
