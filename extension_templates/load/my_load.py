"""A load of your own, and the manifest by which scenes find it."""

from dataclasses import dataclass

import hhr_dolfinx as hhr
from hhr_dolfinx.forms.elasticity import traction
from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(name="my_load", parts={"loads": {"MyLoad": "my_load:MyLoad"}})


@dataclass(frozen=True)
class MyLoad:
    """Force per area along x on tagged facets, proportional to a parameter.

    Attributes:
        tag: facet tag.
        parameter: name of the parameter.
    """

    tag: int
    parameter: str

    def terms(self, assembler):
        """Terms of F, each a vector with its amplitude; see hhr_dolfinx.loads.Assembler."""
        # TODO: your form, linear in assembler.test, and its amplitude
        form = traction(assembler.test, (1.0, 0.0), assembler.hypothesis, assembler.ds(self.tag))
        return [hhr.Term(hhr.Amplitude(slopes={self.parameter: 1.0}), assembler.vector(form))]
