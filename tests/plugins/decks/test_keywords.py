"""Each keyword and option of decks has the outcome that the table of the reader says, and so has
the documentation.

The expected outcomes are those of the table itself: it is what this package reads, and no other
program owns that.
"""

from pathlib import Path

import pytest
from deck_texts import bar, blocks
from recorded import Recorded

from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.geometries import abaqus_deck
from hhr_dolfinx.plugins.decks import keywords
from hhr_dolfinx.plugins.decks.commands import deck_of
from hhr_dolfinx.plugins.decks.keywords import (
    AS_TODO,
    IDLE,
    OUT,
    READ,
    REFUSED,
    TABLE,
    blocks_of,
    rows_of_docs,
)

DOCS = Path(__file__).parents[3] / "docs/decks.md"
PULLED = "*CLOAD\nBAR_X1, 1, 2.5"
CREEP = "*CREEP\n1e-6, 3., 0.\n"
PILOT = "*NODE\n901, 5., 0.2, 0.9\n903, 0., 0., 2.\n904, 0., 1., 0.\n*SURFACE, NAME=HEAD\n4, S4\n"
TOUCH = "*CONTACT PAIR, INTERACTION=TOUCH"
PART = (
    "*PART, NAME=CUBE\n*NODE\n1, 0., 0., 0.\n2, 1., 0., 0.\n3, 1., 1., 0.\n4, 0., 1., 0.\n5, 0., "
    "0., 1.\n6, 1., 0., 1.\n7, 1., 1., 1.\n8, 0., 1., 1.\n*ELEMENT, TYPE=C3D8, ELSET=CELLS\n1, 1, "
    "2, 3, 4, 5, 6, 7, 8\n*NSET, NSET=FOOT\n1, 2, 3, 4\n*SOLID SECTION, ELSET=CELLS, "
    "MATERIAL=M\n*END PART\n*ASSEMBLY, NAME=A\n*INSTANCE, NAME=I, PART=CUBE\n*END "
    "INSTANCE\n*NSET, NSET=ONE, INSTANCE=I\n1\n*ELSET, ELSET=CELL, INSTANCE=I\n1\n*END "
    "ASSEMBLY\n*MATERIAL, NAME=M\n*ELASTIC\n1000., 0.3\n*BOUNDARY\nI.FOOT, 1, "
    "3\n*STEP\n*STATIC\n*CLOAD\nI.8, 1, 1.\n*END STEP\n"
)
GENERATED = (
    "*NODE\n1, 0., 0.\n3, 2., 0.\n11, 0., 1.\n13, 2., 1.\n*NGEN, NSET=LOW\n1, 3, 1\n*NGEN, "
    "NSET=HIGH\n11, 13, 1\n*NFILL, NSET=ALL\nLOW, HIGH, 1, 10\n*ELEMENT, TYPE=CPE4, "
    "ELSET=FIRST\n1, 1, 2, 12, 11\n*ELGEN, ELSET=BODY\n1, 2, 1, 1\n*MATERIAL, "
    "NAME=M\n*ELASTIC\n1000., 0.3\n*SOLID SECTION, ELSET=BODY, MATERIAL=M\n*BOUNDARY\nLOW, 1, "
    "2\n*STEP\n*STATIC\n*CLOAD\nHIGH, 1, 1.\n*END STEP\n"
)


def before_step(lines):
    """The bar with some lines before its step."""
    return bar(PULLED).replace("*STEP", PILOT + lines + "*STEP")


def touching(interaction="", before=""):
    return blocks("*DSLOAD\nUPPER_TOP, P, 1.", interaction=interaction, before=before)


HEATED = (
    blocks(
        "*BOUNDARY\nUPPER_Z1, 11, 11, 100.\n*DFLUX\nUPPER, BF, 2.\n*FILM\n1, F3, 10., 2.\n"
        "*DSFLUX\nUPPER_TOP, S, 3.\n*SFILM\nUPPER_TOP, F, 10., 2.\n*CFLUX\nUPPER_Z1, 11, 1.",
        interaction="*FRICTION\n0.3\n*GAP CONDUCTANCE\n20., 0.\n30., 5.\n"
        "*GAP HEAT GENERATION\n1., 0.5, 20.",
    )
    .replace("*STATIC", "*COUPLED TEMPERATURE-DISPLACEMENT, STEADY STATE")
    .replace("*SOLID", "*SPECIFIC HEAT\n2.\n*CONDUCTIVITY\n20.\n*SOLID", 1)
)
HEAT_WORDS = (
    "CONDUCTIVITY",
    "SPECIFIC HEAT",
    "GAP CONDUCTANCE",
    "GAP HEAT GENERATION",
    "DFLUX",
    "DSFLUX",
    "FILM",
    "SFILM",
    "CFLUX",
    "COUPLED TEMPERATURE-DISPLACEMENT",
)
EXAMPLES = {
    **dict.fromkeys(HEAT_WORDS, HEATED),
    "UNCOUPLED TEMPERATURE-DISPLACEMENT": HEATED.replace("*COUPLED", "*UNCOUPLED"),
    **dict.fromkeys(
        ("NODE", "ELEMENT", "NSET", "MATERIAL", "ELASTIC", "SOLID SECTION"), bar(PULLED)
    ),
    **dict.fromkeys(("BOUNDARY", "STEP", "STATIC", "CLOAD"), bar(PULLED)),
    "SURFACE": touching(),
    "ELSET": bar(PULLED).replace("*MATERIAL", "*ELSET, ELSET=HALF\n1, 2, 1\n*MATERIAL"),
    **dict.fromkeys(("NGEN", "NFILL", "ELGEN"), GENERATED),
    **dict.fromkeys(("PART", "INSTANCE"), PART),
    "PLASTIC": bar(PULLED, "*PLASTIC\n8., 0.\n12., 0.04\n"),
    "CREEP": bar(PULLED, CREEP),
    "VISCO": bar(PULLED, CREEP).replace("*STATIC", "*VISCO"),
    "DENSITY": bar("*DLOAD\nBAR, GRAV, 5., 1., 0., 0.", "*DENSITY\n2.\n"),
    "DLOAD": bar("*DLOAD\n4, P4, -10."),
    "DSLOAD": touching(),
    **dict.fromkeys(
        ("TEMPERATURE", "EXPANSION"), bar("*TEMPERATURE\nALL, 120.", "*EXPANSION\n1e-4\n")
    ),
    "INITIAL CONDITIONS": bar(
        "*TEMPERATURE\nALL, 120.",
        "*EXPANSION\n1e-4\n*INITIAL CONDITIONS, TYPE=TEMPERATURE\nALL, 20.\n",
    ),
    "AMPLITUDE": bar("*AMPLITUDE, NAME=A\n0., 0., 2., 2.\n*CLOAD, AMPLITUDE=A\nBAR_X1, 1, 2.5"),
    **dict.fromkeys(("CONTACT PAIR", "SURFACE INTERACTION"), touching()),
    "SURFACE BEHAVIOR": touching("*SURFACE BEHAVIOR\n1e6"),
    "FRICTION": touching("*FRICTION\n0.3"),
    "CLEARANCE": touching(before="*CLEARANCE, SLAVE=UPPER_BOTTOM, MASTER=LOWER_TOP, VALUE=0.1"),
    "GAP": before_step(
        "*ELEMENT, TYPE=GAPUNI, ELSET=G\n700, 903, 20\n*GAP, ELSET=G\n0.01, 0., 0., -1.\n"
    ).replace("BAR_X0, 1\n", "BAR_X0, 1\n903, 1, 3\n"),
    "RIGID BODY": before_step("*RIGID BODY, NSET=BAR_X1, REF NODE=901\n"),
    "EQUATION": before_step("*EQUATION\n2\n5, 2, 1., 10, 2, -1.\n"),
    "MPC": before_step("*MPC\nMEANROT, 3, 3, 3, 4, 4, 4, 8, 8, 8, 904\n"),
    "TIE": blocks("*DSLOAD\nUPPER_TOP, P, 1.").replace(f"{TOUCH}\n", "*TIE, NAME=T\n"),
    "CYCLIC SYMMETRY MODEL": before_step(
        "*SURFACE, NAME=Y, TYPE=NODE\nBAR_Y0\n*SURFACE, NAME=Z, TYPE=NODE\nBAR_Z0\n*TIE, NAME=T, "
        "CYCLIC SYMMETRY\nZ, Y\n*CYCLIC SYMMETRY MODEL, N=4, TIE=T\n0., 0., 0., 1., 0., 0.\n"
    ),
    **dict.fromkeys(
        ("COUPLING", "KINEMATIC"),
        before_step("*COUPLING, REF NODE=901, SURFACE=HEAD, CONSTRAINT NAME=C\n*KINEMATIC\n1, 1\n"),
    ),
    "DISTRIBUTING": before_step(
        "*COUPLING, REF NODE=901, SURFACE=HEAD, CONSTRAINT NAME=C\n*DISTRIBUTING\n1, 3\n"
    ),
    "DISTRIBUTING COUPLING": before_step(
        "*ELEMENT, TYPE=DCOUP3D, ELSET=D\n700, 901\n*DISTRIBUTING COUPLING, ELSET=D\nBAR_X1, 1.\n"
    ),
    "PRE-TENSION SECTION": before_step(
        "*SURFACE, NAME=CUT\n2, S4\n*PRE-TENSION SECTION, SURFACE=CUT, NODE=903\n"
    ),
    "TRANSFORM": before_step("*TRANSFORM, NSET=BAR_Y0, TYPE=R\n1., 1., 0., -1., 1., 0.\n"),
}
VALUES = {  # samples of options with a value that a deck must have
    "AMPLITUDE": "A",
    "CPSET": "SET",
    "TAUMAX": "5.",
    "ELSET": "BAR",
    "NSET": "BAR_X0",
    "ROT NODE": "901",
    "SYSTEM": "R",
    "ANALYTICAL SURFACE": "HEAD",
    "POSITION TOLERANCE": "0.1",
    "ORIENTATION": "AXES",
    "TIME DELAY": "0.1",
    "INSTANCE": "I",
    "COMBINE": "UNION",
    "TYPE": "",
}
NEXT = "*END STEP\n*STEP\n*STATIC\n"
CURVE = "*AMPLITUDE, NAME=A\n0., 0., 2., 2.\n"
OWN = {  # decks of single options
    ("BOUNDARY", "FIXED"): bar(
        f"*BOUNDARY\nBAR_X1, 1, 1, 0.04\n{NEXT}*BOUNDARY, FIXED\nBAR_X1, 1, 1"
    ),
    **{
        ("STEP", f"AMPLITUDE={kind}"): bar(f"{PULLED}\n{NEXT}{PULLED}", CREEP).replace(
            "*STEP", f"*STEP, AMPLITUDE={kind}"
        )
        for kind in ("STEP", "RAMP")
    },
    ("RIGID BODY", "ELSET"): before_step(
        "*ELSET, ELSET=END\n4\n*RIGID BODY, ELSET=END, REF NODE=901\n"
    ),
    ("RIGID BODY", "ANALYTICAL SURFACE"): touching(
        before="*NODE\n901, 0., 0., 3.\n*SURFACE, NAME=P, TYPE=CYLINDER\nSTART, -5., 3.\n"
        "LINE, 5., 3.\n"
        "*RIGID BODY, ANALYTICAL SURFACE=P, REF NODE=901"
    ),
    ("CLEARANCE", "CPSET"): touching(before="*CLEARANCE, CPSET=SET, VALUE=0.1").replace(
        TOUCH, f"{TOUCH}, CPSET=SET"
    ),
    ("CONTACT PAIR", "CPSET"): touching(before="*CLEARANCE, CPSET=SET, VALUE=0.1").replace(
        TOUCH, f"{TOUCH}, CPSET=SET"
    ),
    ("TIE", "NAME"): before_step(
        "*TIE, NAME=T, CYCLIC SYMMETRY\nBAR_Z0, BAR_Y0\n*CYCLIC SYMMETRY MODEL, N=4, TIE=T\n0., "
        "0., 0., 1., 0., 0.\n"
    ),
    **{("NSET", name): PART for name in ("INSTANCE",)},
    **{("ELSET", name): PART for name in ("INSTANCE",)},
    ("SURFACE", "COMBINE"): touching(
        before="*SURFACE, NAME=BOTH, COMBINE=UNION\nUPPER_TOP, UPPER_BOTTOM"
    ),
    ("NSET", "ELSET"): bar(PULLED).replace("*MATERIAL", "*NSET, NSET=CELLS, ELSET=BAR\n*MATERIAL"),
    ("NSET", "GENERATE"): bar(PULLED).replace(
        "*MATERIAL", "*NSET, NSET=SOME, GENERATE\n1, 3, 1\n*MATERIAL"
    ),
    ("ELSET", "GENERATE"): bar(PULLED).replace(
        "*MATERIAL", "*ELSET, ELSET=SOME, GENERATE\n1, 3, 1\n*MATERIAL"
    ),
    ("NGEN", "LINE=C"): GENERATED.replace(
        "*NGEN, NSET=HIGH\n11, 13, 1", "*NGEN, NSET=HIGH, LINE=C\n11, 13, 1, , 1., 0."
    ),
    ("NODE", "SYSTEM"): bar(PULLED).replace("*NODE,", "*NODE, SYSTEM=R,"),
}


def with_option(keyword, option):
    """Deck with one option in the first block of a keyword, and the line of that."""
    name, _, value = option.partition("=")
    if (keyword, option) in OWN:
        text = OWN[keyword, option]
        lines = text.splitlines()
        return text, next(
            k for k, line in enumerate(lines, 1) if line.startswith(f"*{keyword}") and name in line
        )
    lines = EXAMPLES[keyword].splitlines()
    number = next(k for k, line in enumerate(lines) if line.partition(",")[0] == f"*{keyword}")
    head, *options = lines[number].split(", ")
    value = "OTHER" if value == "*" else value or VALUES.get(name, "")
    there = [one for one in options if one.partition("=")[0] == name]
    if not there or option.partition("=")[2]:
        options = [one for one in options if one not in there] + [
            f"{name}={value}" if value else name
        ]
    lines[number] = ", ".join([head, *options])
    if name == "AMPLITUDE" and keyword != "STEP":
        lines.insert(0, CURVE.rstrip())
        number += len(CURVE.splitlines())
    return "\n".join(lines) + "\n", number + 1


ROWS = [(name, option, rule) for name, one in TABLE.items() for option, rule in one.options.items()]


@pytest.mark.parametrize(
    ("keyword", "option", "rule"), ROWS, ids=[f"{name}, {option}" for name, option, _ in ROWS]
)
def test_an_option_has_its_outcome(keyword, option, rule, tmp_path, monkeypatch):
    """Refused with its name, a TODO line with its name, looked up by a reader, or hidden from
    it.
    """
    text, number = with_option(keyword, option)
    path = tmp_path / "deck.inp"
    path.write_text(text)
    name = option.partition("=")[0]
    if rule.outcome == REFUSED:
        with pytest.raises(HHRError, match=rf"\*{keyword}"):
            deck_of(path)
        return
    asked = set()
    plain, read = abaqus_deck.blocks, keywords.readable
    kept, left = blocks_of(path)
    source = f"deck.inp:{number}"
    said = [one for one in left if one.source == source and one.why.startswith(name)]
    (block, *_) = [*(one for one in kept if one.source == source), None]
    assert bool(said) == bool(rule.why) and (rule.outcome not in (AS_TODO, OUT) or rule.why)
    assert (block is None) == (rule.outcome == OUT)
    assert block is None or (name in block.options) == (rule.outcome == READ)
    if rule.outcome == READ:

        def recorded(path):
            for line, word, options, rows in plain(path):
                yield line, word, Recorded(options, word, asked), rows

        monkeypatch.setattr(abaqus_deck, "blocks", recorded)
        monkeypatch.setattr(
            keywords,
            "readable",
            lambda options, rules, word: Recorded(read(options, rules, word), word, asked),
        )
        deck_of(path)
        assert (keyword, name) in asked


@pytest.mark.parametrize(
    "keyword", [name for name, one in TABLE.items() if one.rule.outcome == AS_TODO] + ["NOVEL WORD"]
)
def test_a_keyword_that_is_not_read_is_named(keyword, tmp_path):
    path = tmp_path / "deck.inp"
    path.write_text(bar(PULLED).replace("*STEP", f"*{keyword}, NAME=X\n*STEP"))
    (left,) = deck_of(path).left
    assert left.keyword == f"*{keyword}" and left.why and left.source.startswith("deck.inp:")


@pytest.mark.parametrize(
    "keyword", [name for name, one in TABLE.items() if one.rule.outcome == READ]
)
def test_an_option_that_nobody_knows_is_named(keyword, tmp_path):
    path = tmp_path / "deck.inp"
    text, number = with_option(keyword, "NOVEL=1")
    path.write_text(text)
    assert [str(one) for one in blocks_of(path)[1]] == [
        f"TODO deck.inp:{number} *{keyword}: NOVEL=1: it is not read"
    ]


def test_all_outcomes_are_in_the_table():
    assert {rule.outcome for _, _, rule in ROWS} == {READ, IDLE, AS_TODO, OUT, REFUSED}


def test_the_documentation_has_the_table():
    """Write the rows that this has into docs/decks.md if it fails."""
    assert "\n".join(rows_of_docs()) in DOCS.read_text("utf-8")


def test_a_misspelt_keyword_is_named_with_the_right_one():
    assert keywords.keyword_of("BOUNDRY").rule.why == "no counterpart: is *BOUNDARY meant?"
    assert keywords.keyword_of("NOWHERE TO BE READ").rule.why == "no counterpart"
