"""Non-negative factors of forces."""

from __future__ import annotations

import warnings

import numpy as np

from hhr_dolfinx.compat import extra


def nonnegative_factors(forces: np.ndarray, count: int) -> np.ndarray:
    """Left factor of a non-negative factorisation of forces, over its norms, (N_lambda, r).

    Args:
        forces: forces, (N_lambda, S).
        count: most columns.
    """
    with extra("rivals", "a basis of non-negative factors"):
        from sklearn.decomposition import NMF

    count = min(count, *forces.shape)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that it stopped at max_iter: factors are used as they are
        factors = NMF(count, init="nndsvda", max_iter=2000, tol=1e-7, random_state=0).fit_transform(
            np.maximum(forces, 0.0)
        )
    factors = factors[:, np.linalg.norm(factors, axis=0) > 0]
    return np.asarray(factors / np.linalg.norm(factors, axis=0))
