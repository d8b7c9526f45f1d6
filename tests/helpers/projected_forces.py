"""Contact with several laws by projected forces alone, without Newton's method and statuses: a
reference for tests.

x <- projection of x - c s with one small c, s = free + S x. The projections are closed forms: the
resolvent of a cubic by its real root, that of wear by hand, and friction of the plane by an
interval.
"""

import numpy as np


def projected(schur, free, projection, start=None, most=1_000_000):
    """Forces of a fixed point of a projection, ``(y, c) -> forces``, and the number of steps."""
    c = 1.0 / np.linalg.eigvalsh(schur)[-1]
    forces = np.zeros(len(free)) if start is None else start
    for count in range(most):  # noqa: B007
        new = projection(forces - c * (free + schur @ forces), c)
        if np.abs(new - forces).max() <= 1e-15 * np.abs(new).max():
            break
        forces = new
    return new, count


def cubic(y, c, linear, third):
    """k1 d + k3 d^3 where k3 d^3 + (k1 + c) d = y, by the hyperbolic form of the root.

    Zero for y < 0.
    """
    y = np.maximum(y, 0.0)
    p, q = (linear + c) / third, y / third
    d = 2.0 * np.sqrt(p / 3.0) * np.sinh(np.arcsinh(1.5 * q / p * np.sqrt(3.0 / p)) / 3.0)
    return np.where(linear + 3.0 * third * d**2 > c, y - c * d, linear * d + third * d**3), d


class Reference:
    """Three ranges of rows: pairs of friction in the plane, gaskets, and wear.

    All other rows are unilateral.
    """

    def __init__(
        self, schur, normal, tangential, mu, gasket=(), constants=(1.0, 1.0), wearing=(), rate=0.0
    ):
        self.schur = schur
        self.normal, self.tangential, self.mu = normal, tangential, mu
        self.gasket, self.constants = np.array(gasket, dtype=int), constants
        self.wearing, self.rate = np.array(wearing, dtype=int), rate
        self.position = np.zeros(len(tangential))
        self.worn = np.zeros(len(self.wearing))
        self.forces = None

    def increment(self, free, seconds):
        """Forces of an increment from the free slack, and the number of steps."""
        free = free.copy()
        free[self.tangential] -= self.position
        free[self.wearing] += self.worn
        depth = self.rate * seconds

        def projection(y, c):
            found = np.maximum(y, 0.0)
            if self.gasket.size:
                found[self.gasket], _ = cubic(y[self.gasket], c, *self.constants)
            found[self.wearing] = found[self.wearing] / (1.0 + c * depth)
            bound = self.mu * found[self.normal]
            found[self.tangential] = np.clip(y[self.tangential], -bound, bound)
            return found

        self.forces, count = projected(self.schur, free, projection, self.forces)
        slack = free + self.schur @ self.forces
        bound = self.mu * self.forces[self.normal]
        slips = np.abs(self.forces[self.tangential]) >= bound * (1.0 - 1e-9)
        self.position = self.position + np.where(slips, slack[self.tangential], 0.0)
        self.worn = self.worn + depth * self.forces[self.wearing]
        self.closure = np.maximum(-slack[self.gasket], 0.0)
        return self.forces, count
