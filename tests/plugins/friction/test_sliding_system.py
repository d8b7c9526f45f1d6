"""Systems of increments with friction beside the dense matrix of all their rows, written out."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from hhr_dolfinx.errors import SingularError
from hhr_dolfinx.plugins.friction.sliding_system import Rows, SlidingSystem, SlidingSystems, Statuses


def problem(rng, contacts=6, directions=2, motions=0) -> Rows:
    """Contacts with tangential rows behind them, all of a scaled S, and rigid motions."""
    m = contacts * (1 + directions)
    root = rng.normal(size=(m, m))
    schur = root @ root.T + m * np.eye(m)
    taken = rng.normal(size=(m, motions))
    unit = 1.0 / np.diag(schur)[:, None]
    owner = np.repeat(np.arange(contacts), directions)
    return Rows(
        np.hstack([schur, -taken]) * unit, taken.T.copy(), contacts + np.arange(owner.size), owner,
        np.full(owner.size, directions == 2),
    )  # fmt: skip


def statuses(rng, rows: Rows) -> Statuses:
    """Any statuses: open, sticking, slipping by pressure or by a limit, in any direction."""
    m = len(rows.scaled)
    contacts = m - rows.tangential.size
    directions = rows.tangential.size // contacts
    kind = rng.integers(0, 4, contacts)
    acting = np.ones(m, dtype=bool)
    acting[:contacts] = kind > 0
    each = np.repeat(kind, directions)
    acting[rows.tangential] = each > 0
    ways = rng.normal(size=(contacts, directions))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    followed = np.where(each == 3, 0.0, np.repeat(rng.random(contacts), directions))
    shrunk = np.repeat(rng.random(contacts), directions)
    return Statuses(acting, each > 1, followed, ways.ravel(), shrunk, 0.2)


def dense(rows: Rows, at: Statuses) -> np.ndarray:
    """Every row as the module's docstring says it, (M + r, M + r)."""
    m = len(rows.scaled)
    matrix = np.eye(rows.scaled.shape[1])
    matrix[:m][at.acting] = rows.scaled[at.acting]
    matrix[m:, m:] = 0.0
    matrix[m:, :m] = rows.balance
    one = np.eye(rows.scaled.shape[1])
    for k, row in enumerate(rows.tangential):
        if not at.slips[k]:
            continue
        matrix[row] = one[row] - at.followed[k] * at.direction[k] * one[rows.normal[k]]
        if rows.curved[k]:
            other = k + 1 if k % 2 == 0 else k - 1
            y = {j: one[rows.tangential[j]] - at.measure * rows.scaled[rows.tangential[j]] for j in (k, other)}
            along = at.direction[k] * y[k] + at.direction[other] * y[other]
            matrix[row] -= at.shrunk[k] * (y[k] - at.direction[k] * along)
    return matrix


@pytest.mark.parametrize("directions", [1, 2])
@pytest.mark.parametrize("motions", [0, 2])
def test_a_system_without_slip_is_the_one_with_all_rows(directions, motions):
    rng = np.random.default_rng(directions + 10 * motions)
    for _ in range(40):
        rows = problem(rng, directions=directions, motions=motions)
        at = statuses(rng, rows)
        if motions and at.acting[:6].sum() < 3:  # too little holds the bodies
            continue
        right = rng.normal(size=(rows.scaled.shape[1], 3))
        found = SlidingSystem(rows, at).solve(right)
        np.testing.assert_allclose(dense(rows, at) @ found, right, atol=1e-9)


@pytest.mark.parametrize("directions", [1, 2])
def test_systems_that_differ_in_few_rows_share_factors(directions, monkeypatch):
    rng = np.random.default_rng(directions)
    made = []
    assembled = SlidingSystem._assembled
    monkeypatch.setattr(SlidingSystem, "_assembled", lambda self: made.append(1) or assembled(self))
    rows = problem(rng, contacts=20, directions=directions)
    systems = SlidingSystems(rows)
    at = statuses(rng, rows)._replace(followed=np.full(20 * directions, 0.3))
    # what turns is another row each time, so that few of them may
    at = at if directions == 1 else at._replace(slips=np.zeros(40, dtype=bool))
    right = rng.normal(size=len(rows.scaled))
    for _ in range(30):
        found = systems.solve(at, right, b"same")
        np.testing.assert_allclose(dense(rows, at) @ found, right, atol=1e-9)
        assert systems.holds(at, right, found) and not systems.holds(at, right, found + 1.0)
        contact = rng.integers(20)
        at = at._replace(acting=at.acting.copy(), slips=at.slips.copy())
        own = slice(contact * directions, (contact + 1) * directions)
        at.acting[contact] = at.acting[rows.tangential[own]] = not at.acting[contact]
        at.slips[own] = at.acting[contact] and rng.random() < 0.5 / directions**2
    assert len(made) < 15
    with pytest.raises(SingularError):
        SlidingSystem(rows._replace(scaled=0.0 * rows.scaled), at)


def test_old_factors_bring_nearer_where_directions_turned():
    rng = np.random.default_rng(4)
    rows = problem(rng, contacts=20)
    systems = SlidingSystems(rows)
    at = statuses(rng, rows)
    right = rng.normal(size=len(rows.scaled))
    near = systems.solve(at, right, b"same")
    angle = 0.02
    pairs = at.direction.reshape(-1, 2)
    turned = np.column_stack([pairs[:, 0] - angle * pairs[:, 1], pairs[:, 1] + angle * pairs[:, 0]])
    turned /= np.linalg.norm(turned, axis=1)[:, None]
    at = at._replace(direction=turned.ravel())
    exact = np.linalg.solve(dense(rows, at), right)
    errors = [np.abs(near - exact).max()]
    for _ in range(3):
        near = systems.nearer(at, right, b"same", near)
        errors.append(np.abs(near - exact).max())
    assert all(after < 0.2 * before for before, after in pairwise(errors))
    assert systems.nearer(at, right, b"other", near) is None
    assert systems.nearer(at._replace(slips=~at.slips & at.acting[rows.tangential]), right, b"same", near) is None
