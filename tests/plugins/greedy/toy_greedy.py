"""Thesis Alg. 1.3 as printed, in one file: one snapshot at a time, where the indicator is
largest.
"""

import numpy as np

import hhr_dolfinx as hhr


def printed_greedy(full, grid, first, n_max, eta_max, indicator, recipe):
    """Places in the grid of what is selected, in this order, and the indicators of each iteration
    on the whole grid.

    As printed the worst parameter is added before the tolerance is looked at. Parameters that are
    selected already do not compete, and get -inf.

    Args:
        full: the full model.
        grid: P_grid, (n, P).
        first: places in it of the snapshots of the first model, "quelques snapshots
            pré-sélectionnés".
        n_max: most snapshots that are selected besides.
        eta_max: indicator below which it stops.
        indicator: eta, as ``hhr.Eta2()``.
        recipe: of the models.
    """
    score = indicator.prepared(full)
    selected = list(first)
    iterations = []
    for _ in range(n_max):
        known = hhr.compute_snapshots(full, grid[selected])
        model = hhr.build(full, known, recipe.as_it_is())
        answers = list(model.solve_many(grid, outside="ignore"))
        eta = np.linalg.norm(score(model, known, answers).reshape(len(grid), -1), axis=1)
        eta[selected] = -np.inf
        iterations.append(eta)
        worst = int(np.argmax(eta))
        selected.append(worst)
        if eta_max > eta[worst]:
            break
    return selected, iterations
