"""Entries that all reports on frictional contact share: sizes, times, ratios, errors of forces and
slip.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import summary


def differences(
    full: hhr.FullOrderModel, found: hhr.History, exact: hhr.History
) -> dict[str, np.ndarray]:
    """Relative errors of each increment in the Euclidean norm, of normal and tangential forces and
    of slip.

    The denominator is at least a thousandth of the largest norm along the history.
    """
    rows = {"normal": np.setdiff1d(np.arange(full.conditions), full.law.tangential)}
    rows["tangential"] = full.law.tangential
    values = {
        name: [
            np.array([answer.forces()[own] for answer in history.answers])
            for history in (found, exact)
        ]
        for name, own in rows.items()
    }
    values["slip"] = [
        np.array([answer.slip.path for answer in history.answers]) for history in (found, exact)
    ]
    errors = {}
    for name, (one, two) in values.items():
        sizes = np.linalg.norm(two, axis=1)
        errors[name] = np.linalg.norm(one - two, axis=1) / np.maximum(
            sizes, 1e-3 * sizes.max() or 1.0
        )
    return errors


def errors_of(rows: Sequence[dict[str, np.ndarray]]) -> dict[str, dict[str, float]]:
    """Median, 95th percentile and maximum over all increments of some histories, by kind of
    error.
    """
    return {name: summary(np.concatenate([row[name] for row in rows])) for name in rows[0]}


def sizes_and_times(
    full: hhr.FullOrderModel, seconds: dict[str, Sequence[float]], offline: float | dict[str, float]
) -> dict[str, Any]:
    """Entries ``sizes``, ``times`` and ``ratios`` of a report whose small model keeps all contact
    conditions.

    Args:
        full: the full-order model; N and N_lambda count all its unknowns and rows, tangential rows
            included.
        seconds: of an increment, one number for each history, by ``fom_best`` and ``online``.
        offline: of all that comes before the first query.
    """
    rows = full.problem.contact.shape[0]
    times = {name: summary(values) for name, values in seconds.items()}
    ratio = float(np.median(np.divide(seconds["fom_best"], seconds["online"])))
    return {
        "sizes": {
            "N": full.problem.free.size,
            "N_lambda": rows,
            "N_lambda_C": rows,
            "cells": len(full.problem.cell_nodes),
        },
        "times": {"offline": offline, **times},
        "ratios": {"fom_best/online": ratio},
    }
