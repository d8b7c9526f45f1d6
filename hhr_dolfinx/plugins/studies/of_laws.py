"""Studies of bodies with laws: what a plug-in measures, advises and draws, its facet ``study``."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Protocol

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import Answer, History
from hhr_dolfinx.models.answer import Path as HistoryPath
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.plugins.studies.advice import Advice
from hhr_dolfinx.plugins.studies.measure import Measurement, Report
from hhr_dolfinx.plugins.studies.settings import StudySettings, View
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.study.training.train import Progress, Training


class StudiedLaws(Protocol):
    """Study of a scene whose bodies have laws."""

    def check(self, settings: StudySettings) -> None:
        """Raise StudyError for a ``correction`` of the settings that is invalid."""

    def measure(
        self,
        training: Training,
        settings: StudySettings,
        tests: Mapping[Hashable, HistoryPath],
        progress: Progress,
    ) -> tuple[KeptModel, Measurement]:
        """Model under study, and errors and times of small models along test paths.

        Args:
            training: training of the scene.
            settings: settings of the study.
            tests: test paths by label.
            progress: makes progress bars.
        """

    def advice(self, report: Report) -> Advice:
        """Method for the scene, from the report."""

    def fields(
        self, full: FullOrderModel, answers: dict[str, Answer], view: View
    ) -> dict[str, dict[str, np.ndarray]]:
        """Fields of the cells to draw, by their names and those of the answers.

        Args:
            full: the full model.
            answers: answers by the name of their model.
            view: view of the study.
        """

    def cells(self, model: KeptModel) -> np.ndarray:
        """Cells in which a model evaluates its laws or integrates."""

    def draw(self, histories: dict[str, History], contacts: np.ndarray, folder: Path) -> None:
        """Draw histories over time.

        Args:
            histories: histories by method.
            contacts: index of the contact of each condition.
            folder: folder of the pictures.
        """


def study_of(scene: Scene) -> StudiedLaws | None:
    """Study of the laws of a scene; None if all bodies are elastic, NotOfferedError if there is
    none for them.
    """
    if not scene.reader:
        return None
    facet: StudiedLaws = registry.facet(scene.reader, "study", f"a study of scene '{scene.name}'")
    return facet
