"""A function of arrays as a law of a body, called as by dolfinx-external-operator (Latyshev,
Bleyer, Maurini and Hale 2025, doi 10.46298/jtcam.14449), which is not needed for it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.inelastic.outside import STANDARD_MEMORY, LawStep, OutsideLaw

NONE: Mapping[str, int] = MappingProxyType({})


class ExternalOperator(OutsideLaw):
    """A law by the ``external_function`` of a ``FEMExternalOperator`` whose first operand is the
    strain.

    ``external((1, 0, ...))`` is the function that returns the derivative of the stress by the first
    operand, and further results. Points come as cells of one point: tensors, in Kelvin's notation,
    as (n, 1, c), numbers as (n, 1). Results may have any shape, points first. Stores of answers
    identify the law by its source and constants: other values that the function reads must not
    change.

    Args:
        external: this function.
        constants: numbers, or formulas of the parameters, by name.
        operands: arguments by name: ``strain`` or its ``increment`` first, then ``stress``,
            ``inelastic``, ``cumulated`` and ``memory`` before the step, ``dt``, ``young``,
            ``poisson`` and constants.
        results: what it returns by name: ``tangents``, ``stress`` and memory after the step, or
            ``+`` and a name for an increment.
        memory: further internal variables, see :class:`~hhr_dolfinx.plugins.inelastic.law.Law`.
    """

    def __init__(
        self,
        external: Callable[[tuple[int, ...]], Callable[..., Sequence[np.ndarray]]],
        constants: Mapping[str, float | str] = NONE,
        *,
        operands: Sequence[str] = ("increment", "stress", "cumulated"),
        results: Sequence[str] = ("tangents", "stress", "+cumulated"),
        memory: Mapping[str, int] = NONE,
    ):
        available = {"increment", "stress", "dt", "young", "poisson", "tangents", *STANDARD_MEMORY}
        twice = sorted((available & {*memory, *constants}) | ({*memory} & {*constants}))
        if not callable(external) or twice:
            raise SceneError(
                f"{external!r} must be the external_function of an operator, and {twice} of "
                "memory and constants are names that all such laws have: give others"
            )
        wrong = {*operands} - available - {*memory} - {*constants} | {*operands} & {"tangents"}
        wrong |= (
            {name.removeprefix("+") for name in results} ^ {"tangents", "stress", *memory}
        ) - {"cumulated"}
        wrong |= {*results} & {"+tangents"}
        if wrong or not operands or operands[0] not in ("increment", "strain"):
            raise SceneError(
                f"operands {operands} begin with strain or increment, and results {results} are "
                f"tangents, stress and the memory {list(memory)}: {sorted(wrong)} are missing or "
                "unknown"
            )
        self.external = external
        self.operands = operands
        self.results = results
        self.memory = dict(memory)  # type: ignore[misc]
        try:
            source = inspect.getsource(external)
        except (OSError, TypeError):  # compiled, typed into a console, or an object
            source = external.__module__
        name = getattr(external, "__qualname__", type(external).__qualname__)
        super().__init__(name, constants, "dt" in operands, source, *operands, *results)

    def evaluate(
        self, step: LawStep
    ) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray | None]:
        """See :class:`OutsideLaw`; tangents come with the stress in any case.

        Raises:
            SceneError: if the function does not return its results as numbers of their shapes.
        """
        old = step.old
        available = {
            **old,
            **step.constants,
            "dt": step.dt,
            "strain": step.strain,
            "increment": step.strain - old["strain"],
        }
        arrays = (
            np.array(available[name]) for name in self.operands
        )  # copies, as a function may write into them
        cells = [
            array[:, None] if array.ndim else np.full((len(step.strain), 1), array)
            for array in arrays
        ]
        results = self.external((1,) + (0,) * (len(cells) - 1))(*cells)
        points, strains = step.strain.shape
        sizes = {"tangents": strains * strains, "stress": strains}
        values = {}
        try:
            for name, value in zip(self.results, results, strict=True):
                variable = name.removeprefix("+")
                shape = (points, sizes[variable]) if variable in sizes else old[variable].shape
                values[variable] = np.reshape(np.asarray(value, dtype=float), shape) + (
                    0.0 if variable == name else old[variable]
                )
        except (TypeError, ValueError) as error:
            raise SceneError(
                f"{self.name} does not return its results {self.results} as numbers for {points} "
                f"points and strains of {strains} components: {error}"
            ) from error
        return values.pop("stress"), values, values.pop("tangents")
