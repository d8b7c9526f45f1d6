"""Keywords and options of decks of CalculiX and Abaqus with their outcomes: the one place that
decides what is read.

Readers get blocks with the options that they read. All others become TODO lines, unknown ones too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.abaqus_blocks import blocks
from hhr_dolfinx.plugins.decks.deck import Left
from hhr_dolfinx.plugins.decks.inp_steps import COUPLED_STEPS, HEATING, KeywordBlock

READ = "read"
IDLE = "no effect"
AS_TODO = "TODO"
OUT = "TODO, block left out"
REFUSED = "refused"
"""Outcomes: answers do not depend on an option without effect.

TODO lines name the others, with a remedy.
"""


@dataclass(frozen=True)
class Rule:
    """Outcome of an option, and the sentence of its TODO line or of its refusal.

    What is read may have one too.
    """

    outcome: str
    why: str = ""


@dataclass(frozen=True)
class Keyword:
    """Outcome of a keyword, and those of its options.

    Attributes:
        rule: outcome of the keyword itself. Options of one that is not read do not count.
        options: rules by option, ``NAME``, or ``NAME=VALUE`` for a value alone; ``NAME=*`` are all
            other values, and ``*`` all other options.
    """

    rule: Rule
    options: Mapping[str, Rule] = field(default_factory=dict)

    def rule_of(self, name: str, value: str) -> Rule:
        """Rule of an option with its value, both in capitals.

        An option that is not in the table is left.

        Args:
            name: name of the option in capitals.
            value: its value in capitals.
        """
        for key in (f"{name}={value}", f"{name}=*", name):
            if key in self.options:
                return self.options[key]
        if "*" in self.options:
            return self.options["*"]
        values = [key for key in self.options if key.startswith(f"{name}=")]
        return Rule(OUT if values else AS_TODO, "it is not read")


def read_options(read: str = "", idle: str = "") -> Keyword:
    """Keyword that is read, with options by name, separated by ``|``.

    Args:
        read: options that are read.
        idle: options without effect.
    """
    options = {name: Rule(READ) for name in filter(None, read.split("|"))}
    options |= {name: Rule(IDLE) for name in filter(None, idle.split("|"))}
    return Keyword(Rule(READ), options)


def with_options(keyword: Keyword, outcome: str, options: Mapping[str, str]) -> Keyword:
    """Keyword with further options of one outcome.

    Args:
        keyword: the keyword.
        outcome: outcome of the options.
        options: sentences of their TODO lines, by name.
    """
    return Keyword(
        keyword.rule,
        {
            **keyword.options,
            **{name: Rule(outcome, sentence) for name, sentence in options.items()},
        },
    )


def left_options(keyword: Keyword, **options: str) -> Keyword:
    """Keyword with further options that are TODO lines.

    Args:
        keyword: the keyword.
        **options: sentences of the TODO lines; ``_`` in a name stands for a blank.
    """
    return with_options(
        keyword, AS_TODO, {name.replace("_", " "): sentence for name, sentence in options.items()}
    )


def out_options(keyword: Keyword, options: Mapping[str, str]) -> Keyword:
    """Keyword with options that leave its block out.

    Args:
        keyword: the keyword.
        options: sentences of their TODO lines, by name.
    """
    return with_options(keyword, OUT, options)


def refused_options(keyword: Keyword, options: Mapping[str, str]) -> Keyword:
    """Keyword with options that are refused.

    Args:
        keyword: the keyword.
        options: sentences of the refusals, by name.
    """
    return with_options(keyword, REFUSED, options)


_FIRST_LINE = "values that depend on fields: those of the first line count"
_STABLE = "no damping is added here, and the answer is that without"
_DELAY = "the amplitude begins with its step here: shift its times"
_USER = "a subroutine is not read: write its values"
_SUBMODEL = "displacements of another analysis are not read: impose them on named sets"
_IMAGINARY = "no counterpart: loads here are real"
_UNEQUAL = "write the deck with all nodes and elements, as a preprocessor does"
_FIXED = "it keeps values of earlier steps, of a bolt its force and not its length"
_OF_MATERIALS = {
    "MATERIAL": read_options("NAME", "DESCRIPTION|RTOL"),
    "ELASTIC": refused_options(
        left_options(
            read_options("", "TYPE=ISO|TYPE=ISOTROPIC"),
            DEPENDENCIES=_FIRST_LINE,
            MODULI="moduli do not relax here",
        ),
        {
            "TYPE=*": (
                "E and nu are needed: give it these, and change the body to hhr.Orthotropic in "
                "the scene"
            )
        },
    ),
    "PLASTIC": out_options(
        left_options(
            read_options("HARDENING=ISOTROPIC|HARDENING=KINEMATIC"),
            **{"HARDENING=COMBINED": "it is read as isotropic: hhr.Chaboche has backstresses"},
            RATE="its curve counts at any rate: hhr.Perzyna depends on the rate",
            DEPENDENCIES=_FIRST_LINE,
        ),
        {"HARDENING=*": "its hardening is not read, and the body stays elastic: give it a law"},
    ),
    "CREEP": out_options(
        left_options(read_options("LAW=NORTON|LAW=STRAIN|LAW=TIME"), DEPENDENCIES=_FIRST_LINE),
        {
            "LAW=*": (
                "its law has no counterpart, and the body does not creep: give it a law in the "
                "scene"
            )
        },
    ),
    "EXPANSION": out_options(
        left_options(
            read_options("", "TYPE=ISO|TYPE=ISOTROPIC|ZERO"),
            **{"TYPE=*": "its first number counts in all directions"},
            DEPENDENCIES=_FIRST_LINE,
        ),
        {"USER": _USER},
    ),
    "DENSITY": left_options(read_options(), DEPENDENCIES=_FIRST_LINE),
    "CONDUCTIVITY": left_options(
        read_options("", "TYPE=ISO|TYPE=ISOTROPIC"),
        **{"TYPE=*": "its first number counts in all directions"},
        DEPENDENCIES=_FIRST_LINE,
    ),
    "SPECIFIC HEAT": left_options(read_options(), DEPENDENCIES=_FIRST_LINE),
}
_OF_BODIES = {
    "SOLID SECTION": out_options(
        left_options(
            read_options("ELSET|MATERIAL", "ORIENTATION|CONTROLS|STACK DIRECTION|SYMMETRIC"),
            REF_NODE="generalized plane strain has no counterpart: the thickness does not change",
            NODAL_THICKNESS="thicknesses of nodes are not read: give one for the section",
        ),
        {"COMPOSITE": "layers have no counterpart: give each layer cells and a section"},
    ),
    "RIGID BODY": left_options(
        read_options(
            "ELSET|NSET|REF NODE|ROT NODE|ANALYTICAL SURFACE", "ISOTHERMAL|POSITION=INPUT"
        ),
        **{"POSITION=CENTER OF MASS": "its reference node stays at its place in the file"},
        PIN_NSET="its nodes do not follow the body: hhr.MeanMotion moves them",
        TIE_NSET="its nodes do not follow the body: hhr.RigidMotion moves them",
    ),
}
_OF_CONTACT = {
    "CONTACT PAIR": left_options(
        read_options(
            "INTERACTION|CPSET|TIED",
            "TYPE|SMALL SLIDING|EXTENSION ZONE|HCRIT|SMOOTH|NO THICKNESS|SUPPLEMENTARY "
            "CONSTRAINTS|TRACKING|MINIMUM DISTANCE|DEVPATH",
        ),
        ADJUST=(
            "no node moves here: gaps and overlaps are those of the mesh, see hhr check. "
            "hhr.Opening(CONTACT, 0.0, overwrites=True) closes gaps"
        ),
        GEOMETRIC_CORRECTION="surfaces are those of the mesh",
    ),
    "SURFACE INTERACTION": left_options(
        read_options("NAME", "UNSYMM"),
        PAD_THICKNESS="surfaces are those of the mesh: hhr.Opening(CONTACT, -THICKNESS) adds a pad",
        USER="a subroutine is not read: contact is hard and frictionless, see hhr.ContactLaw",
    ),
    "SURFACE BEHAVIOR": left_options(
        read_options(
            "PRESSURE-OVERCLOSURE=LINEAR|PRESSURE-OVERCLOSURE=EXPONENTIAL|"
            "PRESSURE-OVERCLOSURE=TABULAR|PRESSURE-OVERCLOSURE=TIED|NO SEPARATION",
            "PRESSURE-OVERCLOSURE=HARD|AUGMENTED LAGRANGE|PENALTY|DIRECT",
        ),
        **{
            "PRESSURE-OVERCLOSURE=*": (
                "contact is hard here, surfaces do not overlap; law=hhr.SoftContact(...) of the "
                "pair has curves"
            ),
        },
    ),
    "FRICTION": left_options(
        read_options("TAUMAX|ROUGH", "LAGRANGE|SLIP TOLERANCE|ELASTIC SLIP|SHEAR TRACTION SLOPE"),
        EXPONENTIAL_DECAY=(
            "friction does not depend on the speed: its first number, that at rest, counts"
        ),
        ANISOTROPIC="friction is equal in all directions: its first number counts",
        TEST_DATA="friction does not depend on the speed: its first number, that at rest, counts",
        DEPENDENCIES=_FIRST_LINE,
        USER=(
            "a subroutine is not read, and the pair has no friction here: give it friction= or a "
            "law"
        ),
    ),
    "GAP": read_options("ELSET"),
    "GAP CONDUCTANCE": out_options(
        left_options(read_options("PRESSURE"), DEPENDENCIES=_FIRST_LINE), {"USER": _USER}
    ),
    "GAP HEAT GENERATION": out_options(read_options(), {"USER": _USER}),
    "CLEARANCE": out_options(
        read_options("MASTER|SLAVE|VALUE|CPSET"),
        {
            "TABULAR": (
                "clearances of single nodes are not read: hhr.Opening(CONTACT, VALUE, "
                "overwrites=True) has one"
            )
        },
    ),
}
_OF_CONSTRAINTS = {
    "EQUATION": out_options(read_options(), {"REMOVE": "no counterpart: all equations hold"}),
    "MPC": out_options(read_options("", "MODE"), {"USER": _USER}),
    "TIE": out_options(
        read_options(
            "NAME|CYCLIC SYMMETRY|POSITION TOLERANCE",
            "ADJUST|TYPE|NO ROTATION|NO THICKNESS|CONSTRAINT RATIO",
        ),
        dict.fromkeys(
            ("MULTISTAGE", "FLUID PERIODIC", "FLUID CYCLIC"),
            "no counterpart: two surfaces are tied",
        ),
    ),
    "CYCLIC SYMMETRY MODEL": read_options("N|TIE", "NGRAPH|CHECK|ELSET"),
    "COUPLING": left_options(
        read_options("REF NODE|SURFACE|ORIENTATION", "CONSTRAINT NAME"),
        INFLUENCE_RADIUS="all nodes of its surface are coupled: name a smaller one",
    ),
    "KINEMATIC": read_options(),
    "DISTRIBUTING": left_options(
        read_options("CYCLIC SYMMETRY"),
        WEIGHTING_METHOD="nodes count by their areas",
        COUPLING="mean rotations are those of the best fit",
    ),
    "DISTRIBUTING COUPLING": read_options("ELSET"),
    "PRE-TENSION SECTION": out_options(
        read_options("SURFACE|NODE"),
        {
            "ELEMENT": (
                "no counterpart: pretension of a beam. Give the bolt cells, and SURFACE= a "
                "section of them"
            )
        },
    ),
    "TRANSFORM": out_options(
        read_options("NSET|TYPE=R|TYPE=C"), {"TYPE=*": "no counterpart: spherical axes"}
    ),
}
_OF_LOADS = {
    "BOUNDARY": out_options(
        left_options(
            read_options("OP=NEW|OP=MOD|AMPLITUDE", "TYPE=DISPLACEMENT|REGION TYPE"),
            LOAD_CASE=_IMAGINARY,
            TIME_DELAY=_DELAY,
        ),
        {
            "USER": _USER,
            "SUBMODEL": _SUBMODEL,
            "TYPE=*": "velocities and accelerations have no counterpart: impose displacements",
        },
    ),
    "CLOAD": out_options(
        left_options(
            read_options("OP=NEW|OP=MOD|AMPLITUDE", "REAL|REGION TYPE|FOLLOWER=NO"),
            FOLLOWER="forces keep their directions",
            LOAD_CASE=_IMAGINARY,
            TIME_DELAY=_DELAY,
            SECTOR="it acts on all sectors",
        ),
        {"USER": _USER, "SUBMODEL": _SUBMODEL, "IMAGINARY": _IMAGINARY},
    ),
    "DLOAD": out_options(
        left_options(
            read_options("OP=NEW|OP=MOD|AMPLITUDE", "REAL|REGION TYPE|FOLLOWER"),
            LOAD_CASE=_IMAGINARY,
            TIME_DELAY=_DELAY,
            SECTOR="it acts on all sectors",
        ),
        {"USER": _USER, "IMAGINARY": _IMAGINARY},
    ),
    "TEMPERATURE": out_options(
        left_options(read_options("OP=NEW|OP=MOD|AMPLITUDE"), TIME_DELAY=_DELAY),
        {
            "USER": _USER,
            "SUBMODEL": _SUBMODEL,
            "FILE": "temperatures of another analysis are not read: list them",
        },
    ),
    "INITIAL CONDITIONS": out_options(
        read_options("TYPE=TEMPERATURE"),
        {
            "TYPE=*": (
                "bodies begin without stress, strain and motion: give hhr.Body a stress= for one"
            ),
            "TYPE=CONTACT": "contacts that touch are bonded by no word here",
            "USER": _USER,
            "FILE": "temperatures of another analysis are not read: list them",
        },
    ),
}
_OF_LOADS |= {
    name: out_options(
        left_options(
            read_options("OP=NEW|OP=MOD|AMPLITUDE", "REGION TYPE"),
            FILM_AMPLITUDE="coefficients are those of the file",
            TIME_DELAY=_DELAY,
        ),
        {"USER": _USER},
    )
    for name in HEATING
}
_OF_LOADS["BOUNDARY"] = with_options(_OF_LOADS["BOUNDARY"], READ, {"FIXED": _FIXED})
_OF_LOADS["DSLOAD"] = out_options(
    left_options(_OF_LOADS["DLOAD"], CONSTANT_RESULTANT="tractions are per area of the mesh"),
    {
        "ORIENTATION": (
            "tractions in local axes are not read: give hhr.Traction a direction of the mesh"
        )
    },
)
_OF_STEPS = {
    "STEP": left_options(
        read_options(
            "AMPLITUDE=STEP|AMPLITUDE=RAMP|PERTURBATION",
            "NAME|INC|INCF|UNSYMM|CONVERT SDI|EXTRAPOLATION|NLGEOM=NO|SOLVER|NO FLUID",
        ),
        NLGEOM="large displacements: strains and rotations are small here",
    ),
    "STATIC": left_options(
        read_options("", "DIRECT|SOLVER|FULLY PLASTIC|LONG TERM|ALLSDTOL|CONTINUE=NO|ADIABATIC=NO"),
        STABILIZE=_STABLE,
        FACTOR=_STABLE,
        RIKS="loads reach the values of the file: no path is followed beyond a limit load",
        TIME_RESET="the time of all steps goes on",
        TOTAL_TIME_AT_START="the time of all steps begins at 0",
    ),
    "VISCO": left_options(
        read_options("", "CETOL|CREEP|DIRECT|SOLVER|EXPLICIT"), STABILIZE=_STABLE, FACTOR=_STABLE
    ),
    **dict.fromkeys(
        COUPLED_STEPS,
        left_options(
            read_options("STEADY STATE", "DIRECT|SOLVER|EXPLICIT|ALPHA|DELTMX|CREEP|CETOL"),
            TIME_RESET="the time of all steps goes on",
            TOTAL_TIME_AT_START="the time of all steps begins at 0",
        ),
    ),
    "AMPLITUDE": refused_options(
        left_options(
            read_options(
                "NAME|TIME=TOTAL TIME|TIME=STEP TIME|TIME DELAY",
                "DEFINITION=TABULAR|VALUE=RELATIVE",
            ),
            SMOOTH="corners of the curve stay sharp",
            **{"TIME=*": "no counterpart: times are those of the step or of all steps"},
        ),
        {
            name: "no counterpart: give a table of times and factors of the loads"
            for name in ("DEFINITION=*", "VALUE=ABSOLUTE", "USER")
        },
    ),
}
_OF_MESHES = {
    "NODE": read_options("NSET|SYSTEM"),
    "ELEMENT": read_options("TYPE|ELSET"),
    "NSET": read_options("NSET|ELSET|GENERATE|UNSORTED|INSTANCE", "INTERNAL"),
    "ELSET": read_options("ELSET|GENERATE|INSTANCE", "INTERNAL|UNSORTED"),
    "SURFACE": left_options(
        read_options("NAME|TYPE|COMBINE|FILLET RADIUS", "INTERNAL|TRIM|NO OFFSET|NO THICK"),
        CROP="the surface is whole",
    ),
    "NGEN": refused_options(
        read_options("NSET|LINE=C", "SYSTEM=RC"), dict.fromkeys(("LINE=*", "SYSTEM=*"), _UNEQUAL)
    ),
    "NFILL": refused_options(
        read_options("NSET"), dict.fromkeys(("BIAS", "SINGULAR", "TWO STEP"), _UNEQUAL)
    ),
    "ELGEN": read_options("ELSET"),
    "PART": read_options("NAME"),
    "INSTANCE": refused_options(
        read_options("NAME|PART"), {"LIBRARY": "write the mesh of the other analysis as a part"}
    ),
}
_NO_EFFECT = (
    "HEADING|END PART|ASSEMBLY|END ASSEMBLY|END INSTANCE|PREPRINT|END STEP|PHYSICAL "
    "CONSTANTS|RESTART|MONITOR|CONTROLS|TIME POINTS|SOLUTION TECHNIQUE|SOLVER "
    "CONTROLS|FILTER|CONTACT CONTROLS|ORIENTATION|NODE FILE|EL FILE|CONTACT FILE|NODE PRINT|EL "
    "PRINT|CONTACT PRINT|SECTION PRINT|ENERGY PRINT|OUTPUT|NODE OUTPUT|ELEMENT OUTPUT|CONTACT "
    "OUTPUT|ENERGY OUTPUT|FILE FORMAT"
)
_OUTPUT = ("FILE", "PRINT", "OUTPUT", "FILE FORMAT")
"""Endings of keywords that choose results."""
_AT_REST = "the state is that at rest, without inertia or modes"
_NAME_PAIRS = (
    "no counterpart: name each pair of surfaces that may touch, hhr.Mortar(SLAVE, MASTER) in "
    "contacts"
)
_ALL_STEPS = "no counterpart: all steps have the values of the first one"
_NOT_READ = {
    **dict.fromkeys(("CONTACT", "CONTACT INCLUSIONS", "CONTACT EXCLUSIONS"), _NAME_PAIRS),
    "CONTACT PROPERTY ASSIGNMENT": "no counterpart: give each pair its friction=",
    "CONTACT INTERFERENCE": (
        "no counterpart: hhr.Opening(CONTACT, -OVERLAP) in openings is an interference, and an "
        "overlap of the mesh is one as it is"
    ),
    "MODEL CHANGE": (
        "no counterpart: all bodies and pairs act in all steps. Leave a removed pair out of "
        "contacts"
    ),
    **dict.fromkeys(
        ("CHANGE FRICTION", "CHANGE CONTACT TYPE", "CHANGE SURFACE BEHAVIOR"), _ALL_STEPS
    ),
    **dict.fromkeys(("DYNAMIC", "FREQUENCY", "BUCKLE", "STEADY STATE DYNAMICS"), _AT_REST),
    "HEAT TRANSFER": "steps of heat alone are not read: contact and heat are solved together here",
    "RADIATE": (
        "no counterpart: hhr.Convection in HEAT, with the coefficient 4 e s T**3, is near it"
    ),
}
TABLE: Mapping[str, Keyword] = {
    **_OF_MESHES,
    **_OF_MATERIALS,
    **_OF_BODIES,
    **_OF_CONTACT,
    **_OF_CONSTRAINTS,
    **_OF_LOADS,
    **_OF_STEPS,
    **{name: Keyword(Rule(IDLE)) for name in _NO_EFFECT.split("|")},
    **{name: Keyword(Rule(AS_TODO, why)) for name, why in _NOT_READ.items()},
}
"""All keywords that are known; others are TODO lines."""
_INCLUDED = ("", "INPUT")
"""Options of any keyword that are read with its lines: a line that goes on, and a file of data
lines.
"""
_COLUMNS = ((READ,), (IDLE,), (AS_TODO, OUT), (REFUSED,))


def keyword_of(name: str) -> Keyword:
    """Outcome of a keyword in capitals.

    An unknown one is a TODO line with the known one that is nearly the same.
    """
    if name in TABLE:
        return TABLE[name]
    if name.endswith(_OUTPUT):
        return Keyword(Rule(IDLE))
    near = get_close_matches(name, TABLE, n=1, cutoff=0.8)
    return Keyword(
        Rule(AS_TODO, f"no counterpart: is *{near[0]} meant?" if near else "no counterpart")
    )


def blocks_of(path: Path) -> tuple[list[KeywordBlock], list[Left]]:
    """Blocks of a deck with the options that are read, and TODO lines of all others.

    Raises:
        FileContentError: for an option that is refused, with the line.
    """
    selected: list[KeywordBlock] = []
    todo: list[Left] = []
    for line, name, options, rows in blocks(path):
        block = KeywordBlock(path.name, line, name, options, rows)
        keyword = keyword_of(name)
        todo += [block.left(keyword.rule.why)] if keyword.rule.outcome == AS_TODO else []
        rules = {}
        if keyword.rule.outcome == READ:
            rules = {
                key: keyword.rule_of(key, value.upper())
                for key, value in options.items()
                if key not in _INCLUDED
            }
            block = KeywordBlock(path.name, line, name, readable(options, rules, name), rows)
        for key, rule in rules.items():
            text = f"{key}={options[key]}: {rule.why}" if options[key] else f"{key}: {rule.why}"
            if rule.outcome == REFUSED:
                raise FileContentError(f"{block.source} *{name}: {text}")
            todo += [block.left(text)] if rule.why else []
        selected += [block] if OUT not in {rule.outcome for rule in rules.values()} else []
    return selected, todo


def readable(
    options: Mapping[str, str], rules: Mapping[str, Rule], keyword: str
) -> Mapping[str, str]:
    """Options of a keyword that a reader gets: no other can have an effect.

    Args:
        options: options of the block, by name in capitals.
        rules: rule of each option that counts.
        keyword: the keyword in capitals.
    """
    return {key: options[key] for key, rule in rules.items() if rule.outcome == READ}


def rows_of_docs(table: Mapping[str, Keyword] = TABLE, mark: str = "*") -> Iterator[str]:
    """Rows of a table of keywords and options in Markdown.

    Args:
        table: the keywords with their outcomes.
        mark: sign before keywords.
    """
    yield "| keyword | options that are read | without effect | TODO line | refused |"
    yield "|---|---|---|---|---|"
    by_cells: dict[tuple[str, ...], list[str]] = {}
    for name, keyword in table.items():
        outcome = keyword.rule.outcome
        cells: tuple[str, ...] = (
            ("", "all", "", "") if outcome == IDLE else ("", "", f"all: {keyword.rule.why}", "")
        )
        if outcome == READ:
            groups = [
                [key for key, rule in keyword.options.items() if rule.outcome in of]
                for of in _COLUMNS
            ]
            cells = (name, *(", ".join(f"`{key}`" for key in keys) for keys in groups))
        by_cells.setdefault(cells, []).append(name)
    for cells, names in by_cells.items():
        yield f"| {', '.join(f'`{mark}{name}`' for name in names)} | {' | '.join(cells[-4:])} |"
