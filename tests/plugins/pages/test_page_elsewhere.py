"""Pages by threads, and of a full model on several ranks."""

import json
import warnings

import contract
import numpy as np
import pytest
from mpirun import launch
from needs import needs
from processes import SCENE_FOLDERS
from threadpoolctl import threadpool_info
from threads import THREADS, at_once

import hhr_dolfinx as hhr


@needs("moduli")
@pytest.mark.usefixtures("restless")
def test_a_page_is_written_by_eight_threads(tmp_path):
    """The same page by each, whatever the others ask the model."""
    model = contract.model_of("interpolated condensation, moduli")
    scenery = hhr.scenery_of(contract.KINDS["interpolated condensation, moduli"].full())
    filters, pools = list(warnings.filters), threadpool_info()

    def page(k):
        return hhr.write_model_page(tmp_path / f"{k}.html", model, scenery).read_text()

    pages = at_once([lambda k=k: page(k) for k in range(THREADS)])
    assert len(set(pages)) == 1
    assert warnings.filters == filters and threadpool_info() == pools


ON_RANKS = f"""
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
    one, several = (json.loads(launch(count, ["-c", ON_RANKS])) for count in (1, ranks))
    assert len(one) > 0 and max(one) > 0
    np.testing.assert_allclose(several, one, rtol=1e-9)
