"""The worst case of an output over the box of the parameters, with a proof.

Boxes are divided, the one with the largest bound first, until no bound exceeds the largest value
found by more than requested. Where the derivative of a candidate has one sign all over a box, its
largest value lies on a face: a parameter less to divide. A box whose statuses cannot change has its
largest value at a corner.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.errors import NotOfferedError, ParameterError
from hhr_dolfinx.files import write_arrays
from hhr_dolfinx.models.shown import table
from hhr_dolfinx.parameters import is_number
from hhr_dolfinx.plugins.worst_case.affine import (
    AffineContact,
    Candidates,
    candidates_of,
    contact_of,
    elimination_of,
    solution_of,
)
from hhr_dolfinx.plugins.worst_case.box_bound import Box, BoxBound, bounded
from hhr_dolfinx.plugins.worst_case.certificate import FORMAT, VERSION
from hhr_dolfinx.timing import now, terminal_lines

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.models.model import AnsweringModel

MOST_PARAMETERS = 12
"""Boxes of more have too many corners to solve at."""


@dataclass(eq=False)
class Node:
    """A box of the proof.

    Attributes:
        box: the box with what is sure in it.
        chosen: numbers of the candidates that are bounded in it, (k,).
        parts: boxes that take its place; empty if its bounds suffice.
    """

    box: Box
    chosen: np.ndarray
    parts: list[Node] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Proof:
    """All boxes of a proof, from the whole box on, and what they were made of.

    Attributes:
        contact: the contact problem.
        outputs: candidates; their largest value is bounded.
        root: the whole box.
        solutions: forces and motions at all corners, (m + r,), by the bytes of their parameters in
            the unit cube.
        proven: no candidate exceeds it.
    """

    contact: AffineContact
    outputs: Candidates
    root: Node
    solutions: Mapping[bytes, np.ndarray]
    proven: float

    def nodes(self) -> Iterator[Node]:
        """All boxes, each before its parts."""
        left = [self.root]
        while left:
            node = left.pop()
            yield node
            left.extend(reversed(node.parts))

    def write(self, path: str | Path, about: Mapping[str, str | bool]) -> None:
        """Write the numbers of the proof.

        Args:
            path: the file, ``.npz``.
            about: what it is about, for the header.
        """
        nodes = list(self.nodes())
        parent_of = {id(part): number for number, node in enumerate(nodes) for part in node.parts}
        candidates = np.arange(len(self.outputs.constant))
        arrays = {
            "schur": self.contact.schur,
            "free": self.contact.free,
            "slopes": self.contact.slopes,
            "constant": self.outputs.constant,
            "along": self.outputs.slopes,
            "weights": self.outputs.weights,
            "proven": np.array(self.proven),
            "parents": np.array([parent_of.get(id(node), -1) for node in nodes], dtype=np.int64),
            "lower": np.array([node.box.lower for node in nodes]),
            "upper": np.array([node.box.upper for node in nodes]),
            "chosen": np.array([np.isin(candidates, node.chosen) for node in nodes]),
            "corners": np.array([np.frombuffer(key) for key in self.solutions]),
            "motions": self.contact.motions,
            "driving": self.contact.driving,
            "solutions": np.array(list(self.solutions.values())),
        }
        write_arrays(path, {"format": FORMAT, "version": VERSION, **about}, arrays)


@dataclass(frozen=True, eq=False)
class WorstCase:
    """Largest or smallest value of an output over the box.

    Attributes:
        output: name of the output.
        unit: its unit.
        smallest: whether the smallest value was requested.
        value: the worst value found.
        parameters: where it was found, by name.
        proven: no parameter in the box has a worse value.
        scale: largest size of the output found, to which differences are relative.
        within: difference requested, relative.
        problems: contact problems solved.
        boxes: boxes of the proof.
        seconds: wall time.
        proof: the boxes, for a certificate.
    """

    output: str
    unit: str
    smallest: bool
    value: float
    parameters: Mapping[str, float]
    proven: float
    scale: float
    within: float
    problems: int
    boxes: int
    seconds: float
    proof: Proof

    @property
    def difference(self) -> float:
        """Difference of the value proven and the one found, relative to the largest size found."""
        apart = abs(self.proven - self.value)
        return apart / self.scale if self.scale else (math.inf if apart else 0.0)

    @property
    def finished(self) -> bool:
        """Whether the difference requested was reached."""
        return self.difference <= self.within * (1 + 1e-12)

    def never_beyond(self, limit: float) -> bool:
        """Whether it is proven that no parameter in the box has a value beyond a limit.

        Args:
            limit: in the unit of the output; a lower limit of a smallest value.
        """
        return self.proven >= limit if self.smallest else self.proven <= limit

    def save(self, path: str | Path) -> None:
        """Write the certificate: the contact problem and all boxes, for
        :func:`~hhr_dolfinx.plugins.worst_case.check.check_certificate`.

        Args:
            path: the file, ``.npz``.
        """
        self.proof.write(path, {"output": self.output, "smallest": self.smallest})

    def facts(self) -> dict[str, str]:
        """What was found, as text by name."""
        word, side = ("smallest", "below") if self.smallest else ("largest", "above")
        at = ", ".join(f"{name} = {value:.6g}" for name, value in self.parameters.items())
        proven = f"{self.proven:.6g} {self.unit}".strip()
        return {
            f"{word} {self.output} found": f"{self.value:.6g} {self.unit}".strip() + f" at {at}",
            "proven": f"nowhere in the box {side} {proven}, {self.difference:.2%} from it",
            "work": f"{self.problems} contact problems, {self.boxes} boxes, {self.seconds:.2g} s",
        }

    def __str__(self) -> str:
        return "\n".join(f"{name}: {text}" for name, text in self.facts().items())

    def _repr_html_(self) -> str:
        return table("Worst case", self.facts())


def worst(
    model: AnsweringModel,
    output: str,
    within: float = 0.01,
    *,
    smallest: bool = False,
    limit: float | None = None,
    seconds: float = 60.0,
) -> WorstCase:
    """The largest value of an output over the box of the parameters, and a proof of it.

    There is no sample: the value proven holds for each point of the box, up to round-off. It is
    that of the finite element mesh, whose contact problem a condensed model of one stiffness has.

    Args:
        model: condensed model of one stiffness without friction.
        output: name of a largest pressure, or of an output that is linear in forces and
            displacements: resultants, moments, displacements, gaps.
        within: largest difference of the value proven and the worst one found, relative to the
            largest size of the output found.
        smallest: ask for the smallest value instead. A gap whose smallest value is above zero never
            closes, a contact whose smallest force is above zero never opens.
        limit: stop as soon as it is known whether the output stays within it.
        seconds: longest time; what is proven by then is returned, with its difference.

    Returns:
        The worst value found, where, and the value proven.

    Raises:
        NotOfferedError: for a model or output without such a proof, with the reason.
        ParameterError: for an unknown output, a number that is not positive, or a limit that is no
            number.
        NotSolvableError, ConvergenceError: if a contact problem has no solution.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> peak = hhr.LargestPressure("peak", contact=0, unit="MPa")
        >>> model = hhr.condense(replace(scene, outputs=(peak,)))
        >>> found = hhr.worst(model, "peak")
        >>> found.finished
        True
    """
    for name, value in (("within", within), ("seconds", seconds)):
        if not is_number(value) or value <= 0:
            raise ParameterError(f"{name} = {value!r} must be a positive number")
    if limit is not None and not is_number(limit):
        raise ParameterError(f"limit = {limit!r} must be a number")
    contact = contact_of(model)
    count = len(contact.width)
    if count > MOST_PARAMETERS:
        raise NotOfferedError(
            f"the worst case is proven for {MOST_PARAMETERS} parameters at most, not for {count}: "
            "each doubles the corners of the box"
        )
    outputs = candidates_of(model, output, contact)
    if smallest:
        outputs = _smallest(outputs, output)
    sign = -1.0 if smallest else 1.0
    search = _BoxSearch(model, contact, outputs, within, None if limit is None else sign * limit)
    start = now()
    proof = search.run(start + seconds)
    unit = next(item.unit for item in model.fields.functionals.items if item.name == output)
    return WorstCase(
        output,
        unit,
        smallest,
        sign * search.best,
        dict(zip(model.parameters.names, contact.point(search.where).tolist(), strict=True)),
        sign * proof.proven,
        search.scale,
        within,
        search.problems,
        search.boxes,
        now() - start,
        proof,
    )


def _smallest(outputs: Candidates, name: str) -> Candidates:
    """Candidates of the negative output.

    Raises:
        ParameterError: for a largest of several candidates, whose smallest value is no largest.
    """
    if len(outputs.constant) > 1:
        raise ParameterError(
            f"the smallest value of '{name}', the largest of {len(outputs.constant)} pressures, is "
            "not proven: ask for a gap, a force or a displacement"
        )
    return outputs.negative()


class _BoxSearch:
    """Branch and bound over the unit cube."""

    def __init__(
        self,
        model: AnsweringModel,
        contact: AffineContact,
        outputs: Candidates,
        within: float,
        limit: float | None,
    ):
        self._model = model
        self._eliminated = elimination_of(model)
        self._contact = contact
        self._outputs = outputs
        self._within = within
        self._limit = limit
        self.best = -math.inf
        self.scale = 0.0
        self.where = np.zeros(0)
        self.boxes = 0
        self._solutions: dict[bytes, np.ndarray] = {}
        # boxes that are left by their largest bound, and the largest bound of those that are not
        self._heap: list[tuple[float, int, Node, np.ndarray, BoxBound]] = []
        self._bounded = -math.inf

    @property
    def problems(self) -> int:
        """Contact problems solved."""
        return len(self._solutions)

    def run(self, until: float) -> Proof:
        """Divide boxes until the difference is reached, or time is over.

        Args:
            until: end of the time, of :func:`hhr_dolfinx.timing.now`.
        """
        root = self._whole()
        self._enter(root, np.full(len(self._outputs.constant), math.inf))
        announce = terminal_lines()
        while self._heap and -self._heap[0][0] > self._enough and now() < until:
            announce("worst case", self._share(-self._heap[0][0]))
            _, _, node, upper, bound = heapq.heappop(self._heap)
            left = upper > self._enough
            self._bounded = max(self._bounded, upper[~left].max(initial=-math.inf))
            for part, chosen in self._parts(bound, left):
                child = Node(part, node.chosen[chosen])
                node.parts.append(child)
                self._enter(child, upper[chosen])
        proven = float(max(self._bounded, self.best, *(-item[0] for item in self._heap)))
        return Proof(self._contact, self._outputs, root, self._solutions, proven)

    def _enter(self, node: Node, known: np.ndarray) -> None:
        """Bound the candidates of a box, and keep it for later if that does not suffice.

        Args:
            node: the box.
            known: bounds of its candidates in the box that it is a part of, (k,).
        """
        self.boxes += 1
        solutions = self._solved(node.box.corners)
        bound = bounded(self._contact, self._outputs, node.chosen, node.box, solutions)
        node.box = bound.box
        upper = np.minimum(bound.upper, known)
        left = (upper > self._enough) & bound.box.divisible.any()
        self._bounded = max(self._bounded, upper[~left].max(initial=-math.inf))
        if left.any():
            heapq.heappush(self._heap, (-upper.max(), self.boxes, node, upper, bound))

    def _share(self, bound: float) -> float:
        """Share of the work, by the difference that is left to a bound."""
        left = bound - self.best
        return min(self._within * self.scale / left, 1.0) if left > 0 else 1.0

    @property
    def _enough(self) -> float:
        """Bound that needs no proof any more."""
        enough = self.best + self._within * self.scale
        if self._limit is None:
            return enough
        return math.inf if self.best > self._limit else max(enough, self._limit)

    def _whole(self) -> Node:
        """The whole box."""
        m, count = self._contact.slopes.shape
        nothing = np.zeros(m, dtype=bool)
        box = Box(np.zeros(count), np.ones(count), nothing, nothing.copy())
        return Node(box, np.arange(len(self._outputs.constant)))

    def _solved(self, corners: np.ndarray) -> np.ndarray:
        """Forces and motions at points of the unit cube, (m + r, n), each solved once; their values
        count.
        """
        missing = [t for t in corners if t.tobytes() not in self._solutions]
        if missing:
            points = np.array([self._contact.point(t) for t in missing])
            answers = self._model.solve_many(points, outside="ignore")
            for t, answer in zip(missing, answers, strict=True):
                self._demand_determined(answer)
                solution = solution_of(answer, self._eliminated, self._contact)
                self._solutions[t.tobytes()] = solution
                value = float(self._outputs.values(t, solution).max())
                self.scale = max(self.scale, abs(value))
                if value > self.best:
                    self.best = value
                    self.where = t
        return np.stack([self._solutions[t.tobytes()] for t in corners], axis=1)

    def _demand_determined(self, answer: Answer) -> None:
        """Raise NotOfferedError if the output reads a motion that nothing determines."""
        m = len(self._contact.free)
        if answer.undetermined is not None and self._outputs.weights[:, m:].any():
            names = self._model.parameters.names
            place = ", ".join(
                f"{name} = {value:.6g}" for name, value in zip(names, answer.parameter, strict=True)
            )
            raise NotOfferedError(
                f"the output reads a motion that neither loads nor contact determine at {place}: "
                "hold the body by a displacement, or narrow the box"
            )

    def _parts(self, bound: BoxBound, left: np.ndarray) -> Iterator[tuple[Box, np.ndarray]]:
        """Boxes that take the place of one, and which of its candidates each has, (k,) bool.

        Args:
            bound: what is known of the box.
            left: candidates whose bound is too large, (k,) bool.
        """
        box = bound.box
        least, most = bound.slopes
        signs = np.where(least >= 0, 1, np.where(most <= 0, -1, 0)) * (box.upper > box.lower)
        for pattern in np.unique(signs[left], axis=0):
            chosen = left & (signs == pattern).all(axis=1)
            if pattern.any():
                yield box.face(pattern), chosen
                continue
            for half in box.halves(bound.axis):
                yield half, chosen
