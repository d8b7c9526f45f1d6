"""Threads write the same page."""

import warnings

import contract
import pytest
from threadpoolctl import threadpool_info
from threads import THREADS, at_once

from hhr_dolfinx.plugins.pages.page import write_model_page
from hhr_dolfinx.plugins.pages.scenery_of import scenery_of


@pytest.mark.usefixtures("restless")
def test_a_page_is_written_by_eight_threads(tmp_path):
    """The same page by each, whatever the others ask the model."""
    model = contract.model_of("interpolated condensation, moduli")
    scenery = scenery_of(contract.KINDS["interpolated condensation, moduli"].full())
    filters, pools = list(warnings.filters), threadpool_info()

    def page(k):
        return write_model_page(tmp_path / f"{k}.html", model, scenery).read_text()

    pages = at_once([lambda k=k: page(k) for k in range(THREADS)])
    assert len(set(pages)) == 1
    assert warnings.filters == filters and threadpool_info() == pools
