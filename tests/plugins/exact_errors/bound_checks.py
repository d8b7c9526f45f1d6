"""Error bounds beside errors.

Where K is fixed they are the errors, to round-off; where moduli vary they lie above them.
"""

import numpy as np

ERRORS = ("primal", "dual", "forces_euclid", "pressure")
NEAR = 1e-9
"""Part of the exact answer by which an estimate may be off the error: its round-off is 2e-10."""


def sizes_of(full, moved, forces):
    """Energy of a displacement; S norm, Euclidean norm and largest pressure of forces."""
    energy = np.sqrt(max(moved @ (full.problem.stiffness @ moved), 0.0))
    own = np.sqrt(max(forces @ full.schur @ forces, 0.0))
    return np.array(
        [energy, own, np.linalg.norm(forces), np.abs(forces / full.problem.contact_areas).max()]
    )


def check(full, model, points, over=None):
    """Estimates are differences to the full model, absolute and over sizes, or ``over``.

    These, (n, 4), as parts.
    """
    parts = []
    for point in points:
        exact, answer = full.solve(point), model.solve(point, outside="ignore")
        field, forces = exact.displacement(), exact.forces()
        true = sizes_of(full, answer.displacement() - field, answer.forces() - forces)
        sizes = sizes_of(full, field, forces)
        said = answer.estimate()
        found = np.array([getattr(said, name) for name in ERRORS])
        assert (
            said.kind == "bound"
            and (true <= found).all()
            and (np.abs(found - true) <= NEAR * sizes).all()
        )
        relative = np.array([getattr(said, f"{name}_relative") for name in ERRORS])
        least = np.append(0.0, model.fields.bound.least)
        least = np.maximum(sizes if over is None else over(field, forces), least)
        assert (np.abs(relative - true / least) <= NEAR * (true + sizes) / least).all()
        parts.append(true / sizes)
    return np.array(parts)


def schur_at(full, point):
    """S of the full model at a point, by dense algebra, and the problem there."""
    problem = full.problem.at(point)
    free = problem.free
    rows = problem.contact[:, free].toarray()
    return rows @ np.linalg.solve(problem.stiffness[free][:, free].toarray(), rows.T), problem


def compared(full, model, points):
    """Bounds and errors, absolute and relative, of displacement and forces."""
    rows, kinds = [], set()
    for point in points:
        schur, problem = schur_at(full, point)
        exact, answer = full.solve(point), model.solve(point, outside="ignore")
        estimate, field, forces = answer.estimate(), exact.displacement(), exact.forces()
        kinds.add(estimate.kind)
        moved, pushed = answer.displacement() - field, answer.forces() - forces
        norms = [moved @ (problem.stiffness @ moved), pushed @ schur @ pushed,
                 field @ (problem.stiffness @ field), forces @ schur @ forces]  # fmt: skip
        rows.append([*estimate[1:5], *np.sqrt(np.maximum(norms, 0.0))])
    return kinds, np.array(rows).T
