"""Von Mises plasticity in numpy, and what laws outside of UFL have in common: histories, refusals,
stores.
"""

import pickle
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from condensing import EVERY, FINE, TIGHT, apart, condensed, cycle, up, walled_tube
from needs import present

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.plugins.inelastic.condensed_flow import CondensedFlowModel

YIELD, SLOPE = 1.0, 5.0
FIELDS = *EVERY, "plastic_strain"


def von_mises(increment, stress, cumulated, *, young, poisson, yield_stress, hardening):
    """Tangents, (..., c, c), stress after a step, (..., c), and the increment of p, (...).

    Numbers may be arrays.
    """
    size = increment.shape[-1]
    unit = np.array([1.0, 1.0, 1.0] + [0.0] * (size - 3))
    dev = np.eye(size) - np.outer(unit, unit) / 3
    mu = np.asarray(young / (2 + 2 * poisson))
    bulk = np.asarray(young / (3 - 6 * poisson))
    elastic = bulk[..., None, None] * np.outer(unit, unit) + 2 * mu[..., None, None] * dev
    trial = stress + np.einsum("...ij,...j->...i", elastic, increment)
    s = trial @ dev
    q = np.sqrt(1.5 * (s * s).sum(-1))
    amount = np.maximum(q - yield_stress - hardening * cumulated, 0) / (3 * mu + hardening)
    n = np.divide(s, q[..., None], out=np.zeros_like(s), where=(amount > 0)[..., None])
    ratio = 3 * mu * np.divide(amount, q, out=np.zeros_like(q), where=q > 0)
    rank_one = (
        (3 * mu * (3 * mu / (3 * mu + hardening) - ratio))[..., None, None]
        * n[..., :, None]
        * n[..., None, :]
    )
    tangents = elastic - rank_one - 2 * mu[..., None, None] * ratio[..., None, None] * dev
    return tangents, trial - ratio[..., None] * s, amount


@cache
def reference():
    """Full model, training and reduced model of the law in UFL."""
    return modelled(hhr.Plasticity(YIELD, SLOPE))


def modelled(law):
    """The same of any law that is plasticity."""
    full = hhr.FullOrderModel(walled_tube(law, cells=20))
    histories = [full.march(up(0.9), TIGHT), full.march(cycle(0.8), TIGHT)]
    recipe = hhr.Recipe.flowing(domain=hhr.Rid(1)).as_it_is()
    return full, histories, hhr.build(full, hhr.SnapshotSet.of_histories(histories), recipe)


def check_histories(law):
    """Full and reduced histories are those of the law in UFL, of a copy in another process too."""
    _, expected, reduced = reference()
    full, found, model = modelled(law)
    assert len(model.equilibrium.points) < len(full.equilibrium.points)
    for one, other in zip(found, expected, strict=True):
        assert one.answers[-1].plastic_strain().max() > 1e-3
        assert max(apart(one, other, FIELDS)) < 1e-12 and one.iterations == other.iterations
    unseen = reduced.march(cycle(0.7))
    assert max(apart(model.march(cycle(0.7)), unseen, FIELDS)) < 1e-10
    assert max(apart(pickle.loads(pickle.dumps(model)).march(cycle(0.7)), unseen, FIELDS)) < 1e-10
    return full, found, model


def other_law(condensed, law):
    """A condensed model with a law instead of its own: other arrays, such as points, stay the
    same.
    """
    flow = condensed.flow
    code = law.at_points(flow.components)
    groups = tuple(replace(group, law=group.law and code) for group in flow.groups)
    given = condensed.parameters, condensed.fields, condensed.trained
    return CondensedFlowModel(replace(flow, groups=groups), *given)


def check_condensed(full, found, law):
    """Condensed histories are those of the law in UFL, which a compiled loop solves: round-off of
    steps of 1e-11.

    So are those of a copy in another process, with what is estimated of time steps. Models that are
    trained apart may choose another one of two points that are alike, of which completed fields
    know, and no displacement or force.
    """
    whole, training, _ = reference()
    compiled = condensed(whole, training)
    same = other_law(compiled, law)
    settings = replace(FINE, time_error=True)
    for path in (cycle(0.7), up(0.9, steps=3)):
        expected = compiled.march(path, settings)
        assert (
            expected.answers[-1].plastic_strain().max() > 1e-3
            and expected.answers[-1].forces().any()
        )
        for model in (same, pickle.loads(pickle.dumps(same))):
            history = model.march(path, settings)
            assert max(apart(history, expected, FIELDS)) < 1e-10
            assert history.time_error == pytest.approx(expected.time_error, rel=1e-8) != 0
    made = condensed(full, found)
    history = made.march(path, FINE)
    assert max(apart(history, expected, EVERY)) < 1e-9 and max(history.iterations) < 6
    assert made.flow.points.size < len(full.equilibrium.points) / 2
    return made


def check_refused(full, found, model, law, folder):
    """Files, pages, plane stress and laws around it, each by words that say why."""
    why = f"{law.name} is code outside of UFL"
    small = check_condensed(full, found, law)
    for one in (model, small):
        with pytest.raises(
            NotOfferedError, match=f"{why}, and files, pages, C and FMUs hold none.* folder="
        ):
            hhr.save_model(folder / "model.npz", one)
    assert not list(folder.iterdir())
    if present("pages"):
        from hhr_dolfinx.plugins.pages.flowing import check_flow

        with pytest.raises(NotOfferedError, match="a page marches with condensed flow"):
            check_flow(model)
        with pytest.raises(NotOfferedError, match=why):
            hhr.write_model_page(folder / "page.html", small, hhr.scenery_of(full))
    if present("exporters"):
        from hhr_dolfinx.plugins.exporters.c_header import write_c_header

        with pytest.raises(NotOfferedError, match=why):
            write_c_header(folder / "model.h", small)
    for refused in (
        replace(walled_tube(law), hypothesis="plane_stress"),
        walled_tube(hhr.Heated(law, 1e-5, 20.0)),
    ):
        with pytest.raises(SceneError, match=f"{why}: no plane stress, no heat"):
            hhr.FullOrderModel(refused)


def check_store(law, other, folder):
    """A store has the steps of the law, and none of another one."""
    for given, known in ((law, 0), (law, 4), (other, 0)):
        full = hhr.FullOrderModel(walled_tube(given))
        store = hhr.SnapshotStore(folder, full)
        hhr.compute_snapshots(full, [up(0.9, steps=4)], store=store, settings=TIGHT)
        assert store.found == known


def check_points(law, components, young=200.0):
    """Steps at random points are those of :func:`von_mises`, tangents too.

    E is that of the body unless it is given.
    """
    from hhr_dolfinx.plugins.inelastic.update import Group, Material

    random = np.random.default_rng(components)
    # one of the bodies has no points, as on a rank
    groups = [Group(np.arange(points), 200.0, 0.3, law.at_points(components)) for points in (40, 0)]
    material = Material(groups, components)
    state, strain, stress, p = (
        material.at_rest(),
        np.zeros((40, components)),
        np.zeros((40, components)),
        np.zeros(40),
    )
    given = {"young": young, "poisson": 0.3, "yield_stress": YIELD, "hardening": SLOPE}
    for _ in range(4):
        step = 0.004 * random.standard_normal(strain.shape)
        tangents, stress, amount = von_mises(step, stress, p, **given)
        strain, p = strain + step, p + amount
        found = material.update(strain, state, 0.1, tangent=True)
        bare, state = material.update(strain, state, 0.1, tangent=False), found.state
        checked = [(found.stress, stress), (bare.stress, stress), (found.tangents, tangents)]
        checked += [(state.cumulated, p)] if young == 200.0 else []
        for one, right in checked:
            assert np.abs(one - right).max() <= 1e-12 * np.abs(right).max()
        assert bare.tangents is None
    assert 0 < (amount > 0).sum() < 40 and p.max() > 0.01
