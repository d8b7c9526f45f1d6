"""Findings of the check of a scene, as sentences."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.pairings.surface import Surface
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.warn import collected

OK = "ok"
NOTE = "note"
MISTAKE = "mistake"


class Finding(NamedTuple):
    """One sentence about a scene, the finding and its remedy, and its level: ``ok``, ``note`` or
    ``mistake``.
    """

    level: str
    text: str


@dataclass
class SceneCheck:
    """Findings of a check of a scene, in their order, each once, and its mesh; None if it has none.

    Of each contact pair its surfaces and rows, none if they were refused; of each load its name and
    its nodal forces at the checked parameter, (nodes, dim).
    """

    scene: Scene
    findings: list[Finding] = field(default_factory=list)
    discretisation: Discretisation | None = None
    pairs: list[tuple[list[Surface], ContactRows | None]] = field(default_factory=list)
    forces: list[tuple[str, np.ndarray]] = field(default_factory=list)

    @property
    def mistakes(self) -> list[Finding]:
        """Findings that make the scene unsolvable or meaningless."""
        return [finding for finding in self.findings if finding.level == MISTAKE]

    @property
    def meshed(self) -> Discretisation:
        """Its mesh, for parts of a check that run only if it has one."""
        assert self.discretisation is not None
        return self.discretisation

    @property
    def length(self) -> str:
        """Unit of length after a blank; empty if it is not given."""
        return "" if self.scene.units is None else f" {self.scene.units.length}"

    def say(self, text: str, level: str = OK) -> None:
        """Add a finding, unless the list has it already.

        A pair is checked separately and with all others.

        Args:
            text: the finding, a sentence for the user.
            level: its level, such as ``OK`` or ``MISTAKE``.
        """
        finding = Finding(level, text)
        if finding not in self.findings:
            self.findings.append(finding)

    def note(self, text: str) -> None:
        """Add something to look at."""
        self.say(text, NOTE)

    @contextmanager
    def heard(self) -> Iterator[None]:
        """Turn warnings of a block into notes, and errors into mistakes."""
        with collected(UserWarning) as caught:
            try:
                yield
            except HHRError as error:
                self.say(str(error), MISTAKE)
        for warning in caught:
            self.note(warning.message)
