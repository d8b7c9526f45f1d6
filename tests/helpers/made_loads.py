"""A load whose terms a function makes, for tests of what a user's own load may not return."""

import dataclasses
import typing

import hhr_dolfinx as hhr


@dataclasses.dataclass(frozen=True)
class Made:
    """A load whose terms are made by a function of the assembler."""

    make: typing.Callable

    def terms(self, assembler):
        return self.make(assembler)


def made(terms):
    return {"loads": (Made(terms),)}


def of_form(form):
    """A load with a form that is a function of v and ds of the right side."""
    return made(lambda ask: [hhr.Term(hhr.Amplitude(1.0), ask.vector(form(ask.test, ask.ds(21))))])
