"""Laws as UFL states them, held to the numbers that the package runs."""

from types import SimpleNamespace

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from test_plastic import LAWS, material, some_states
from tubes import POISSON, YOUNG

import hhr_dolfinx as hhr
from hhr_dolfinx.materials.elasticity import lame_parameters
from hhr_dolfinx.plugins.inelastic import return_mapping

LAM, SHEAR = lame_parameters(YOUNG, POISSON)
DT = 0.1


class Stated:
    """Stress, residual of the flow and their derivatives as UFL, evaluated at one Gauss point after the other."""

    def __init__(self, law, components):
        self._line = mesh.create_interval(MPI.COMM_SELF, 1, [0.0, 1.0])
        given = [np.zeros(components), np.zeros(components), 0.0, 0.0]
        self._given = [fem.Constant(self._line, value) for value in given]
        total, plastic, cumulated, flow = self._given
        total, flow = ufl.variable(total), ufl.variable(flow)
        stress = return_mapping.stress_after(total, plastic, flow, YOUNG, POISSON)
        trial = return_mapping.equivalent(return_mapping.trial_deviator(total, plastic, SHEAR))
        if isinstance(law, hhr.Plasticity):
            residual = return_mapping.plasticity(flow, trial, cumulated, SHEAR, law)
        else:
            residual = return_mapping.norton(flow, trial, SHEAR, DT, law)
        stated = {"stress": stress, "trial": trial, "residual": residual}
        stated |= {f"{name}_by_strain": ufl.diff(stated[name], total) for name in ("stress", "residual")}
        stated |= {f"{name}_by_flow": ufl.diff(stated[name], flow) for name in ("stress", "residual")}
        one = fem.Constant(self._line, 1.0)  # a derivative that is a number has no mesh to be evaluated on
        self._expressions = {name: fem.Expression(one * form, np.array([[0.5]])) for name, form in stated.items()}

    def __call__(self, *values):
        for constant, value in zip(self._given, values, strict=True):
            constant.value = value
        cell = np.zeros(1, dtype=np.int32)
        # one row of values, of the shape of the expression or flat, as the version of DOLFINx has it
        found = {
            name: np.reshape(item.eval(self._line, cell), item.ufl_expression.ufl_shape)
            for name, item in self._expressions.items()
        }
        return SimpleNamespace(**found)


@pytest.mark.parametrize("components", [4, 6])
@pytest.mark.parametrize("name", ["plasticity", "perfect plasticity", "norton 4", "norton 20"])
def test_flow_stress_and_tangent_are_those_of_ufl(name, components):
    """The residual is measured by how far a step of Newton's method would still move the flow."""
    law, count = LAWS[name], 12
    strain, old = some_states(5, count, components)
    update = material(law, count, components).update(strain, old, DT, tangent=True)
    # what is elastic bears the stress: with that of UFL there is one plastic strain, which keeps its volume
    rest = strain - update.state.plastic
    spherical = LAM * rest[:, :3].sum(axis=1, keepdims=True) * (np.arange(components) < 3)
    assert update.stress == pytest.approx(spherical + 2 * SHEAR * rest, abs=1e-13 * YOUNG)
    stated, flowing = Stated(law, components), 0
    for k in range(count):
        here = stated(strain[k], old.plastic[k], old.cumulated[k], 0.0)
        flow, slope = (part[0] for part in law.flow(here.trial.reshape(1), old.cumulated[k : k + 1], SHEAR, DT))
        here = stated(strain[k], old.plastic[k], old.cumulated[k], flow)
        tangent = here.stress_by_strain
        if flow > 0:
            flowing += 1
            assert abs(here.residual / here.residual_by_flow) < 1e-12 * here.trial / (3 * SHEAR)
            by_strain = -here.residual_by_strain / here.residual_by_flow
            tangent = tangent + np.outer(here.stress_by_flow, by_strain)
            # the trial stress grows by 3 mu along the deviator of a unit length in strain
            assert np.linalg.norm(by_strain) == pytest.approx(slope * np.sqrt(6) * SHEAR, rel=1e-9)
        else:
            assert here.residual <= 0 and slope == 0
        assert update.state.cumulated[k] == pytest.approx(old.cumulated[k] + flow, rel=1e-12)
        assert update.stress[k] == pytest.approx(here.stress, abs=1e-13 * YOUNG)
        assert update.tangents[k] == pytest.approx(tangent, abs=1e-11 * YOUNG)
    assert 0 < flowing < count or isinstance(law, hhr.Norton)
