"""What a page draws is the same from a full model on several ranks."""

import json

import numpy as np
import pytest
from bare import SCENE_FOLDERS
from test_mpi import launch

PROGRAM = f"""
import sys
sys.path[:0] = {SCENE_FOLDERS}
import json
import numpy as np
from scenes import pressed_block
import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.pages.stress import Stress
solid = hhr.FullOrderModel(pressed_block("solid", simplices=True))
strains = hhr.scenery_of(solid).strains
stress = Stress(strains, solid.parameters.names, solid.parameters.middle)
drawn = stress.mises(stress.rows @ solid.solve(0.05).displacement(), np.array([0.05]))
if solid.comm.rank == 0:
    print(json.dumps(np.sort(drawn[strains.cells]).tolist()))
"""


@pytest.mark.parametrize("ranks", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_stress_that_is_drawn(ranks):
    one, several = (json.loads(launch(count, ["-c", PROGRAM])) for count in (1, ranks))
    assert len(one) > 0 and max(one) > 0
    np.testing.assert_allclose(several, one, rtol=1e-9)
