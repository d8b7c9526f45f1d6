"""Laws of materials in UFL: what a step does at one point, thesis section 6.2 and beyond.

Symmetric tensors are vectors in Kelvin's notation, (xx, yy, zz, √2 xy[, √2 xz, √2 yz]), so that
products of tensors are products of vectors; zz is θθ in axisymmetry. A law gets an :class:`At`,
symbols at the end of a step, and returns a :class:`Stated`. It may have unknowns y, the roots of a
residual; without any it is a closed form. Steps are implicit Euler's unless a law says otherwise.
Tangents follow from stress and residual by differentiation.

Names: ε strain, εp inelastic strain ε - C^-1 σ with the elasticity C of the body, p its cumulated
amount, s deviator of the stress, q = √(3/2) |s|, and Δp the increment of p. λ, μ are Lamé's
constants, K = λ + 2/3 μ.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType, SimpleNamespace
from typing import NamedTuple

import ufl
from ufl.core.expr import Expr

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms.elasticity import lame_of

_NOTHING: Mapping[str, Expr] = MappingProxyType({})


class At(NamedTuple):
    """Symbols of a step at a point, and numbers that are no symbols."""

    strain: Expr  #: at the end of the step: Kelvin's notation
    unknown: SimpleNamespace  #: unknowns of the law by name
    #: before the step: inelastic = ε - C^-1 σ, cumulated, and the memory of the law by name
    old: SimpleNamespace
    dt: Expr  #: duration of the step in seconds
    constants: SimpleNamespace  #: constants by name; young and poisson are those of the body


class Stated(NamedTuple):
    """A law at a point; ``residual`` has as many components as there are unknowns."""

    stress: Expr  #: at the end of the step, in Kelvin's notation
    #: after the step: cumulated, which stays without one, and the memory of the law; ε - C^-1 σ
    #: follows from the stress
    memory: Mapping[str, Expr] = _NOTHING
    residual: Sequence[Expr] = ()  #: zero at the unknowns
    trial: Expr | None = (
        None  # positive where unknowns must be solved for; None if that is everywhere
    )
    start: Mapping[str, Expr] = _NOTHING  #: first iterate of unknowns; 0 without one
    rest: Mapping[str, Expr] = _NOTHING  #: unknowns where ``trial`` is not positive; 0 without one
    #: negative where the law does not hold: the step is refused; it counts where unknowns were
    #: solved for
    limit: Expr | None = None
    reason: str = ""  #: what is wrong there, for the message


def unit(vector: Expr) -> Expr:
    """The unit tensor, of the length of another vector."""
    return ufl.as_vector([1.0, 1.0, 1.0] + [0.0] * (len(vector) - 3))


def trace(vector: Expr) -> Expr:
    """Trace of a tensor."""
    return vector[0] + vector[1] + vector[2]


def deviator(vector: Expr) -> Expr:
    """Deviator of a tensor."""
    return vector - trace(vector) / 3 * unit(vector)


def equivalent(tensor: Expr) -> Expr:
    """Von Mises' equivalent √(3/2) |s| of a deviator."""
    return ufl.sqrt(1.5 * ufl.dot(tensor, tensor))


def lame(constants: SimpleNamespace) -> tuple[Expr, Expr]:
    """λ and μ from E and ν."""
    return lame_of(constants.young, constants.poisson)


def hooke(strain: Expr, constants: SimpleNamespace) -> Expr:
    """Isotropic elasticity: λ tr(ε) 1 + 2 μ ε.

    Args:
        strain: strain in Kelvin's notation.
        constants: ``young`` and ``poisson``.
    """
    lam, mu = lame(constants)
    return lam * trace(strain) * unit(strain) + 2 * mu * strain


def ramps(x: Expr, points: Sequence[tuple[float, float]]) -> Expr:
    """Table as a sum of ramps: linear between its points and beyond the last one.

    It is constant before the first point.

    Args:
        x: argument of the table.
        points: pairs of an argument and a value.
    """
    (first, level), *further = points
    before = 0.0
    value: Expr | float = level
    for position, height in further:
        slope = (height - level) / (position - first)
        value = value + (slope - before) * ufl.max_value(x - first, 0)
        first = position
        level = height
        before = slope
    return value


class _Radial(NamedTuple):
    """Trial state of a law whose inelastic strain goes along the trial deviator."""

    deviator: Expr  #: s = 2 μ dev(ε - εp)
    size: Expr  #: its q
    mean: Expr  #: K tr(ε) 1
    stiff: Expr  #: 3 μ


def _radial(at: At, plastic: Expr | None = None) -> _Radial:
    lam, mu = lame(at.constants)
    turned = 2 * mu * deviator(at.strain - (at.old.inelastic if plastic is None else plastic))
    return _Radial(
        turned, equivalent(turned), (lam + 2 * mu / 3) * trace(at.strain) * unit(at.strain), 3 * mu
    )


def _flowed(at: At, amount: Expr) -> dict[str, Expr]:
    """Memory after a flow Δp."""
    return {"cumulated": at.old.cumulated + amount}


def closed(at: At, flow: Callable[[Expr, Expr], Expr]) -> Stated:
    """Flow in closed form: Δp of the trial stress.

    Args:
        at: symbols of the step.
        flow: Δp as a function of q_tr and 3 μ, 0 where nothing flows.
    """
    trial = _radial(at)
    amount = flow(trial.size, trial.stiff)
    share = ufl.conditional(ufl.gt(amount, 0), amount / trial.size, 0)
    return Stated(trial.mean + (1 - trial.stiff * share) * trial.deviator, _flowed(at, amount))


def plasticity(at: At) -> Stated:
    """Linear hardening, thesis (6.23)-(6.26): q = σ0 + H p while p grows, in closed form."""
    c = at.constants
    held = c.yield_stress + c.hardening * at.old.cumulated
    return closed(at, lambda trial, stiff: ufl.max_value(trial - held, 0) / (stiff + c.hardening))


def hardening(at: At, strength: Callable[[Expr], Expr]) -> Stated:
    """Isotropic hardening: q = R(p) while p grows, with R = ``strength``; one unknown, Δp.

    R may have an infinite slope at p = 0, as Ludwik's σ0 + K p^n with n < 1, see
    :func:`_first_amount`.
    """
    trial = _radial(at)
    amount = at.unknown.amount
    held = at.old.cumulated
    stress = trial.mean + (1 - trial.stiff * amount / trial.size) * trial.deviator
    over = trial.size - strength(held)
    grown = held + ufl.conditional(
        ufl.gt(amount, 0), amount, 0
    )  # iterates below 0 find their way back
    residual = trial.size - trial.stiff * amount - strength(grown)
    return Stated(
        stress,
        {"cumulated": grown},
        [residual],
        over,
        {"amount": _first_amount(at, trial, over, strength)},
    )


def _first_amount(at: At, trial: _Radial, over: Expr, strength: Callable[[Expr], Expr]) -> Expr:
    """First iterate of Δp in q_tr - 3 μ Δp = R(p + Δp), not above the root if R is concave.

    There Newton's method rises to the root, however steep R is. It lies below z = q_over / 3 μ, the
    flow without hardening. Up to z, R rises by r, and with the exponent n = z R'(p + z) / r at its
    end a concave R rises at x z by r x^n at most. So x = 1/2, or (q_over / 2 r)^(1/n) if that is
    less, leaves a residual that is not negative.
    """
    held = at.old.cumulated
    most = ufl.max_value(over, 0) / trial.stiff
    end = ufl.variable(held + most)
    reached = strength(end)
    rise = reached - strength(held)
    inverse = ufl.min_value(rise / (most * ufl.diff(reached, end)), 100)  # 1/n; beyond, R saturates
    share = ufl.conditional(ufl.gt(2 * rise, over), (over / (2 * rise)) ** inverse, 0.5)
    # at 0 the slope may be infinite
    return ufl.conditional(ufl.gt(over, 0), ufl.max_value(most * share, 1e-300), 0)


def voce(at: At) -> Stated:
    """Voce's hardening: R = σ0 + H p + Q (1 - exp(-b p))."""
    c = at.constants
    return hardening(
        at, lambda p: c.yield_stress + c.hardening * p + c.saturation * (1 - ufl.exp(-c.rate * p))
    )


def tabulated(at: At, points: Sequence[tuple[float, float]]) -> Stated:
    """Hardening by a table of R over p, linear beyond its last point.

    Args:
        at: symbols of the step.
        points: pairs of p and R.
    """
    return hardening(at, lambda p: ramps(p, points))


def chaboche(at: At, backs: int) -> Stated:
    """Nonlinear kinematic hardening by n back stresses X = 2/3 Σ C_k α_k, and Voce's R.

    Δα = Δεp - γ α Δp.

    With n = 1 Armstrong and Frederick's law. Implicit Euler's α = (α_old + Δp n) / (1 + γ Δp)
    leaves one unknown, Δp: the direction n is that of s_tr - 2/3 Σ C_k α_k,old / (1 + γ_k Δp),
    Chaboche 1986, doi 10.1016/0749-6419(86)90010-0.

    Args:
        at: symbols of the step.
        backs: number of back stresses, n.
    """
    c = at.constants
    trial = _radial(at)
    amount = at.unknown.amount
    names = [f"back_{k + 1}" for k in range(backs)]
    old = [getattr(at.old, name) for name in names]
    stiff = [getattr(c, f"modulus_{k + 1}") for k in range(backs)]
    fade = [1 / (1 + getattr(c, f"recall_{k + 1}") * amount) for k in range(backs)]

    def strength(p: Expr) -> Expr:
        return c.yield_stress + c.saturation * (1 - ufl.exp(-c.rate * p))

    def relative(shares: Sequence[Expr | float]) -> Expr:
        effective = trial.deviator
        for share, modulus, back in zip(shares, stiff, old, strict=True):
            effective = effective - 2 / 3 * share * modulus * back
        return effective

    size = equivalent(relative(fade))
    along = 1.5 / size * relative(fade)
    resistance = trial.stiff + sum(
        share * modulus for share, modulus in zip(fade, stiff, strict=True)
    )
    backs_after = [share * (back + amount * along) for share, back in zip(fade, old, strict=True)]
    memory = _flowed(at, amount) | dict(zip(names, backs_after, strict=True))
    over = equivalent(relative([1.0] * backs)) - strength(at.old.cumulated)
    residual = size - resistance * amount - strength(at.old.cumulated + amount)
    return Stated(
        trial.mean + trial.deviator - 2 / 3 * trial.stiff * amount * along, memory, [residual], over
    )


def creep(at: At, flow: Callable[[Expr], Expr], highest: Callable[[Expr], Expr]) -> Stated:
    """Flow without threshold: Δp = ``flow``(q), which increases; one unknown, the q that remains.

    q + 3 μ Δp(q) = q_tr is convex and increasing, so that iterates from above fall to the root.
    They start at the smaller of q_tr and ``highest``(q_tr / 3 μ), the q whose flow is that amount.
    """
    trial = _radial(at)
    remaining = at.unknown.stress
    stress = trial.mean + remaining / trial.size * trial.deviator
    start = ufl.min_value(trial.size, highest(trial.size / trial.stiff))
    return Stated(
        stress,
        _flowed(at, flow(remaining)),
        [remaining + trial.stiff * flow(remaining) - trial.size],
        trial.size,
        {"stress": start},
        {"stress": trial.size},
    )


def norton(at: At) -> Stated:
    """Norton's creep, thesis (6.28): rate of p = (q / K)^m."""
    c = at.constants
    return creep(
        at,
        lambda q: at.dt * (q / c.resistance) ** c.exponent,
        lambda amount: c.resistance * (amount / at.dt) ** (1 / c.exponent),
    )


def arrhenius(at: At) -> Stated:
    """Norton's creep with the rate at a temperature T in K: times exp(-Q/R (1/T - 1/T0))."""
    c = at.constants
    return norton(
        at._replace(dt=at.dt * ufl.exp(-c.activation * (1 / c.temperature - 1 / c.reference)))
    )


def primary_creep(at: At) -> Stated:
    """Primary creep p = (q / K)^n t^m at constant stress, by strain hardening: exact in time at
    constant q.

    p^(1/m) grows at the rate (q / K)^(n/m), Bailey 1935 and Norton. Such powers leave the range of
    numbers at small q and p, with n/m of 25 at q = 1e-13 K. So p after the step is their m-norm,
    from the flow a = (q / K)^n dt^m of the step alone: (a^(1/m) + p_old^(1/m))^m, as the larger one
    times a power of their ratio.
    """
    c = at.constants
    held = at.old.cumulated
    m = c.time_exponent

    def flow(q: Expr) -> Expr:
        alone = (q / c.resistance) ** c.exponent * at.dt**m
        most = ufl.conditional(ufl.gt(alone, held), alone, held)
        ratio = (ufl.conditional(ufl.gt(alone, held), held, alone) / most) ** (1 / m)
        # (1 + x)^m - 1, of which differences of numbers near 1 leave nothing at small x
        grown = ufl.conditional(
            ufl.lt(ratio, 1e-6), m * ratio * (1 - (1 - m) / 2 * ratio), (1 + ratio) ** m - 1
        )
        flowed = ufl.conditional(ufl.gt(alone, held), alone - held + most * grown, most * grown)
        return ufl.conditional(ufl.gt(alone, 0), flowed, 0)

    def highest(amount: Expr) -> Expr:
        # above a, as the slope of the power 1/m at its end is above that of the chord
        alone = (amount / m) ** m * (held + amount) ** (1 - m)
        return c.resistance * (alone / at.dt**m) ** (1 / c.exponent)

    return creep(at, flow, highest)


def plasticity_with_creep(at: At) -> Stated:
    """Norton's creep below a yield stress σ0 + H p_p that only plastic flow p_p moves.

    One unknown, the q that remains.

    Two conditions give an upper end of q, each increasing: creep alone, and yield with the flow
    that it leaves. Their larger value is zero at the smaller q.
    """
    c = at.constants
    trial = _radial(at)
    remaining = at.unknown.stress
    crept = at.dt * (remaining / c.resistance) ** c.exponent
    total = (trial.size - remaining) / trial.stiff
    plastic = ufl.max_value(total - crept, 0)
    alone = remaining + trial.stiff * crept - trial.size
    yielding = remaining - c.yield_stress - c.hardening * (at.old.yielded + total - crept)
    memory = _flowed(at, crept + plastic) | {"yielded": at.old.yielded + plastic}
    highest = c.resistance * (trial.size / (trial.stiff * at.dt)) ** (1 / c.exponent)
    return Stated(
        trial.mean + remaining / trial.size * trial.deviator,
        memory,
        [ufl.max_value(alone, yielding)],
        trial.size,
        {"stress": ufl.min_value(trial.size, highest)},
        {"stress": trial.size},
    )


def drucker_prager(at: At) -> Stated:
    """Pressure-dependent yield √(s:s/2) + η σ_m = k + H p in closed form, on the cone or at its
    tip.

    Plastic strain goes along s/(2√(s:s/2)) + ψ/3 1, with the dilatancy ψ; ψ = η is associated. The
    return to the cone holds while it leaves a deviator, and otherwise ends in the tip; de Souza
    Neto et al. 2008, section 8.3.
    """
    c = at.constants
    lam, mu = lame(c)
    bulk = lam + 2 * mu / 3
    elastic = at.strain - at.old.inelastic
    turned = 2 * mu * deviator(elastic)
    size = ufl.sqrt(0.5 * ufl.dot(turned, turned))
    pressed = c.friction * bulk * trace(elastic) - c.cohesion - c.hardening * at.old.cumulated
    stiff = bulk * c.friction * c.dilatancy + c.hardening
    over = size + pressed
    cone = over / (mu + stiff)
    on_cone = ufl.lt(mu * cone, size)
    amount = ufl.conditional(ufl.gt(over, 0), ufl.conditional(on_cone, cone, pressed / stiff), 0)
    share = ufl.conditional(ufl.gt(over, 0), ufl.conditional(on_cone, mu * cone / size, 1), 0)
    swollen = c.dilatancy * amount * unit(at.strain)
    return Stated(
        bulk * (trace(elastic) * unit(at.strain) - swollen) + (1 - share) * turned,
        _flowed(at, amount),
        limit=c.friction - c.dilatancy,
        reason="its dilatancy is above its friction, so that flow would create energy",
    )


def hill(at: At, frame: Sequence[Sequence[float]]) -> Stated:
    """Hill's orthotropic yield in a frame, q_H = σ0 + H p, associated.

    q_H^2 = F (σ22 - σ33)^2 + G (σ33 - σ11)^2 + H12 (σ11 - σ22)^2 + 2 L σ23^2 + 2 M σ13^2 + 2 N
    σ12^2 = σ:P:σ, Hill 1948. The one unknown is ζ = Δp / q_H: s = (1 + 2 μ ζ P)^-1 s_tr, and
    (σ0 + H p) / q_H + H ζ = 1, which is linear in ζ for von Mises' constants.

    Args:
        at: symbols of the step.
        frame: unit vectors of the material as rows.
    """
    c = at.constants
    ratio = at.unknown.ratio
    _, mu = lame(c)
    trial = _radial(at)
    turn = rotation(frame, len(at.strain))
    first = turn * trial.deviator
    block = ufl.as_matrix(
        [[c.g + c.h, -c.h, -c.g], [-c.h, c.f + c.h, -c.f], [-c.g, -c.f, c.f + c.g]]
    )
    shears = [c.n, c.m, c.l][: len(at.strain) - 3]

    def pulled(tensor: Expr) -> Expr:
        """P times a tensor."""
        normal = block * ufl.as_vector([tensor[i] for i in range(3)])
        return ufl.as_vector([*normal, *(shear * tensor[3 + k] for k, shear in enumerate(shears))])

    normal = ufl.inv(ufl.Identity(3) + 2 * mu * ratio * block) * ufl.as_vector(
        [first[i] for i in range(3)]
    )
    turned = [first[3 + k] / (1 + 2 * mu * ratio * shear) for k, shear in enumerate(shears)]
    in_frame = ufl.as_vector([*normal, *turned])
    size = ufl.sqrt(ufl.dot(in_frame, pulled(in_frame)))
    strength = c.yield_stress + c.hardening * at.old.cumulated
    over = ufl.sqrt(ufl.dot(first, pulled(first))) - strength
    stress = ufl.transpose(turn) * in_frame
    return Stated(
        trial.mean + stress,
        _flowed(at, ratio * size),
        [strength / size + c.hardening * ratio - 1],
        over,
    )


def rotation(frame: Sequence[Sequence[float]], size: int) -> Expr:
    """Matrix that turns tensors in Kelvin's notation into a frame.

    The rows of the frame are its unit vectors in the mesh.

    Args:
        frame: unit vectors of the material as rows.
        size: components of a tensor, 4 or 6.

    Raises:
        SceneError: for a frame that turns the axis across the plane.
    """
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)][:size]
    if size == 4 and max(abs(frame[2][0]), abs(frame[2][1])) > 1e-9:
        raise SceneError(
            f"the frame {frame} turns the axis across the plane: its third vector must be (0, 0, 1)"
        )

    def entry(row: tuple[int, int], column: tuple[int, int]) -> float:
        i, j = row
        k, l = column
        product = frame[i][k] * frame[j][l] + frame[i][l] * frame[j][k]
        return product * (1 if i != j else 2**-0.5) * (1 if k != l else 2**-0.5)

    return ufl.as_matrix([[entry(row, column) for column in pairs] for row in pairs])


def orthotropic(at: At, frame: Sequence[Sequence[float]]) -> Stated:
    """Orthotropic elasticity in a frame, by moduli E_i, G_ij and ratios ν_ij.

    ν_ij is the contraction along j by a pull in i.

    Args:
        at: symbols of the step.
        frame: unit vectors of the material as rows.
    """
    c = at.constants
    down = [
        [1 / c.young_1, -c.poisson_12 / c.young_1, -c.poisson_13 / c.young_1],
        [-c.poisson_12 / c.young_1, 1 / c.young_2, -c.poisson_23 / c.young_2],
        [-c.poisson_13 / c.young_1, -c.poisson_23 / c.young_2, 1 / c.young_3],
    ]
    block = ufl.inv(ufl.as_matrix(down))
    shears = [2 * c.shear_12, 2 * c.shear_13, 2 * c.shear_23]
    size = len(at.strain)
    stiff = [
        [block[i, j] if max(i, j) < 3 else (shears[i - 3] if i == j else 0) for j in range(size)]
        for i in range(size)
    ]
    turn = rotation(frame, size)
    return Stated(ufl.transpose(turn) * (ufl.as_matrix(stiff) * (turn * at.strain)))


def lemaitre(at: At) -> Stated:
    """Plasticity with Lemaitre's damage D, up to softening: σ = (1 - D) C (ε - εp).

    One unknown, Δp.

    Of the effective stress, q = R(r) = σ0 + H r with Δr = (1 - D) Δp, and ΔD = (Y / S)^s Δp with
    the energy release Y = q^2 / (2 E) (2/3 (1 + ν) + 3 (1 - 2 ν) (σ_m / q)^2); Lemaitre 1985, doi
    10.1115/1.3225775. Where the stress would fall with p the law is refused: its answer would
    depend on the mesh.
    """
    c = at.constants
    trial = _radial(at, at.old.plastic)
    amount = at.unknown.amount
    mean = trial.mean[0]

    def pace(q: Expr) -> Expr:
        energy = q * q * 2 / 3 * (1 + c.poisson) + 3 * (1 - 2 * c.poisson) * mean * mean
        return (energy / (2 * c.young * c.strength)) ** c.power

    size = trial.size - trial.stiff * amount
    damage = at.old.damage + pace(size) * amount
    hardened = at.old.hardened + (1 - damage) * amount
    residual = size - c.yield_stress - c.hardening * hardened
    over = trial.size - c.yield_stress - c.hardening * at.old.hardened
    plastic = at.old.plastic + 1.5 * amount / trial.size * trial.deviator
    memory = _flowed(at, amount) | {"plastic": plastic, "damage": damage, "hardened": hardened}
    effective = trial.mean + (1 - trial.stiff * amount / trial.size) * trial.deviator
    # besides, roots of the equation that are none of the law: flow backwards or beyond the trial
    # stress, D over 1
    rising = (1 - damage) ** 2 * c.hardening - size * pace(size)
    for least in (size, amount * c.young, (1 - damage) * c.young):
        rising = ufl.min_value(rising, least)
    return Stated(
        (1 - damage) * effective,
        memory,
        [residual],
        over,
        limit=rising,
        reason="its stress falls as strain grows",
    )


def heated(at: At, law: Callable[[At], Stated], names: Sequence[str], kept: str) -> Stated:
    """Another law of the strain without α (T - T0) 1, whose last value is kept.

    ε - C^-1 σ contains it.

    Args:
        at: symbols of the step.
        law: the other law, as a function of its symbols.
        names: names of the constants α, T and T0.
        kept: name of its memory.
    """
    expansion, temperature, reference = (getattr(at.constants, name) for name in names)
    grown = expansion * (temperature - reference)
    old = SimpleNamespace(**vars(at.old))
    old.inelastic = at.old.inelastic - getattr(at.old, kept) * unit(at.strain)
    stated = law(at._replace(strain=at.strain - grown * unit(at.strain), old=old))
    return stated._replace(memory={**stated.memory, kept: grown})


def changing_stiffness(
    at: At, law: Callable[[At], Stated], names: Sequence[str], kept: str
) -> Stated:
    """Another law with a Young's modulus of its own, whose strain without stress is kept.

    That is ε - C^-1 σ by its C.

    Args:
        at: symbols of the step.
        law: the other law, as a function of its symbols.
        names: name of the modulus, alone.
        kept: name of its memory.
    """
    constants = SimpleNamespace(**{**vars(at.constants), "young": getattr(at.constants, names[0])})
    old = SimpleNamespace(**{**vars(at.old), "inelastic": getattr(at.old, kept)})
    stated = law(at._replace(constants=constants, old=old))
    poisson = constants.poisson
    strained = (
        (1 + poisson) * stated.stress - poisson * trace(stated.stress) * unit(at.strain)
    ) / constants.young
    return stated._replace(memory={**stated.memory, kept: at.strain - strained})


def _either(holds: Expr, one: Expr, other: Expr) -> Expr:
    """One of two numbers or vectors; what is not chosen may be no number."""
    if not one.ufl_shape:
        return ufl.conditional(holds, one, other)
    return ufl.as_vector([ufl.conditional(holds, one[k], other[k]) for k in range(len(one))])


def thin(at: At, law: Callable[[At], Stated]) -> Stated:
    """Another law in plane stress: the strain across is one more unknown, for which σ_zz = 0.

    Its inelastic part is kept, as the strain that is given, and so ε - C^-1 σ, has no component
    across. Where nothing flows, the law has its unknowns at rest, and no limit.
    """
    across = at.unknown.across
    old = SimpleNamespace(**vars(at.old))
    inelastic = at.old.inelastic
    old.inelastic = ufl.as_vector([inelastic[0], inelastic[1], at.old.across, inelastic[3]])
    poisson = at.constants.poisson
    elastic = at.old.across - poisson / (1 - poisson) * (
        at.strain[0] + at.strain[1] - inelastic[0] - inelastic[1]
    )
    strains = [
        ufl.as_vector([at.strain[0], at.strain[1], third, at.strain[3]])
        for third in (across, elastic)
    ]
    flowing, first = (law(at._replace(strain=strain, old=old)) for strain in strains)
    stress, memory, residual, limit = (
        flowing.stress,
        dict(flowing.memory),
        list(flowing.residual),
        flowing.limit,
    )
    if flowing.trial is not None:
        flows = ufl.gt(flowing.trial, 0)
        unknown = {name: value for name, value in vars(at.unknown).items() if name != "across"}
        idle = {name: ufl.as_ufl(flowing.rest.get(name, 0)) for name in unknown}
        resting = law(at._replace(strain=strains[0], old=old, unknown=SimpleNamespace(**idle)))
        stress = _either(flows, stress, resting.stress)
        memory = {
            name: _either(flows, value, resting.memory[name]) for name, value in memory.items()
        }
        # no other equation: the value at rest may be a root, whose slope at 0 is no number
        residual = [
            _either(flows, equation, value)
            for equation, value in zip(residual, unknown.values(), strict=True)
        ]
        limit = None if limit is None else ufl.conditional(flows, limit, 1)
    remembered = across + poisson / at.constants.young * (stress[0] + stress[1])
    return flowing._replace(
        stress=ufl.as_vector([stress[0], stress[1], 0, stress[3]]),
        memory=memory | {"across": remembered},
        residual=[*residual, stress[2] / at.constants.young],
        trial=None,
        start={**first.start, "across": elastic},
        rest={},
        limit=limit,
    )


def standard(
    at: At,
    energy: Callable[[Expr, Mapping[str, Expr]], Expr],
    yields: Callable[[Mapping[str, Expr], Mapping[str, Expr]], Expr],
    flow: Callable[[Mapping[str, Expr], Mapping[str, Expr]], Mapping[str, Expr]] | None = None,
) -> Stated:
    """Generalised standard material: free energy ψ(ε, α), and f(A) <= 0 of A = -∂ψ/∂α.

    The unknowns are α after the step, with ``cumulated`` as the multiplier: Δα = Δp ∂f/∂A, or as
    ``flow`` states for some names. Halphen and Nguyen 1975.

    Args:
        at: symbols of the step.
        energy: free energy ψ(ε, α).
        yields: yield function f(A, α).
        flow: Δα / Δp by name as a function of A and α; None for ∂f/∂A.
    """
    names = list(vars(at.unknown))
    alpha = {name: ufl.variable(getattr(at.unknown, name)) for name in names}
    old = {name: ufl.variable(getattr(at.old, name)) for name in names}
    strain = ufl.variable(at.strain)

    def acting(state: Mapping[str, Expr]) -> dict[str, Expr]:
        psi = energy(strain, state)
        return {name: ufl.variable(-ufl.diff(psi, state[name])) for name in names}

    forces = acting(alpha)
    surface = yields(forces, alpha)
    ways = {} if flow is None else flow(forces, alpha)
    amount = alpha["cumulated"] - at.old.cumulated
    residuals = []
    for name in names:
        way = ways[name] if name in ways else ufl.diff(surface, forces[name])
        gradient = alpha[name] - getattr(at.old, name) - amount * way
        residuals.append(surface if name == "cumulated" else gradient)
    before = {name: getattr(at.old, name) for name in names}
    memory = {name: value for name, value in alpha.items() if name != "inelastic"}
    return Stated(
        ufl.diff(energy(strain, alpha), strain),
        memory,
        residuals,
        yields(acting(old), old),
        before,
        before,
    )
