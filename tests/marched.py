"""All bits of answers, for histories that are compared between processes: light to import where DOLFINx is missing."""


def of_answer(answer, outputs=()):
    """All that an answer hands out, as bytes, and outputs by these names."""
    parts = [answer.unknown, answer.multipliers, answer.active, answer.displacement(), answer.forces(), answer.stress(),
             answer.plastic_strain(), *answer.state().state]  # fmt: skip
    if answer.gradient is not None:
        parts += [answer.gradient.unknown, answer.gradient.multipliers]
    values = [answer.outputs()[name].hex() for name in outputs]
    return [*(part.tobytes() for part in parts), *values]


def bits(history, outputs=()):
    """The same of all steps."""
    return [of_answer(answer, outputs) for answer in history.answers]
