"""Each keyword of a command of code_aster has the outcome that the table of the reader says, and so
has the page.

The expected outcomes are those of the table itself: it is what this package reads, and no other
program owns that.
"""

from dataclasses import replace
from pathlib import Path

import pytest
from deck_texts import blocks
from recorded import Recorded

from hhr_dolfinx.plugins.decks import comm_commands
from hhr_dolfinx.plugins.decks.comm_commands import commands_of
from hhr_dolfinx.plugins.decks.comm_keywords import COMMANDS
from hhr_dolfinx.plugins.decks.commands import deck_of
from hhr_dolfinx.plugins.decks.keywords import AS_TODO, OUT, READ, rows_of_docs

DOCS = Path(__file__).parents[3] / "docs/decks.md"
ALL = """
steel = DEFI_MATERIAU(ELAS=_F(E=1000.0, NU=0.0, RHO=2.0, ALPHA=1e-5))
model = AFFE_MODELE(AFFE=_F(TOUT="OUI", MODELISATION="3D"))
fields = AFFE_MATERIAU(AFFE=(_F(GROUP_MA="LOWER", MATER=steel), _F(GROUP_MA="UPPER", MATER=steel)))
held = {kind}(
    MECA_IMPO=(_F(GROUP_MA="LOWER_Z0", LIAISON="ENCASTRE"),
               _F(GROUP_NO="UPPER_X0", DX=0.0, DY=0.0, DZ=0.0)),
    DDL_IMPO=(_F(GROUP_MA="UPPER_Y0", GROUP_NO="UPPER_Y0", DX=0.0, DY=0, DZ=0),
              _F(GROUP_MA="UPPER_Y0", LIAISON="ENCASTRE", BLOCAGE="DEPLACEMENT")),
    FACE_IMPO=(_F(GROUP_MA="UPPER_Z1", DX=0, DY=0, DZ=0), _F(GROUP_NO="UPPER_Z1", DX=0)),
    PRES_REP=_F(GROUP_MA="UPPER_TOP", GROUP_NO="UPPER_TOP", PRES=10.0),
    FORCE_FACE=_F(GROUP_MA="UPPER_TOP", GROUP_NO="UPPER_TOP", FX=1.0, FY=1.0, FZ=1.0),
    FORCE_CONTOUR=_F(GROUP_MA="UPPER_TOP", GROUP_NO="UPPER_TOP", FX=1.0, FY=1.0, FZ=1.0),
    FORCE_NODALE=_F(GROUP_MA="UPPER_TOP", GROUP_NO="UPPER_TOP", FX=1.0, FY=1.0, FZ=1.0),
    PESANTEUR=_F(GRAVITE=9.81, DIRECTION=(0, 0, -1), GROUP_MA="LOWER"),
)
touch = DEFI_CONTACT(FROTTEMENT="COULOMB",
                     ZONE=_F(GROUP_MA_MAIT="LOWER_TOP", GROUP_MA_ESCL="UPPER_BOTTOM", COULOMB=0.3))
rise = DEFI_FONCTION(NOM_PARA="INST", INTERPOL="LIN", VALE=(0.0, 0.0, 1.0, 1.0),
                     PROL_DROITE="CONSTANT", PROL_GAUCHE="CONSTANT")
twice = DEFI_FONCTION(NOM_PARA="INST", ABSCISSE=(0.0, 1.0), ORDONNEE=(2.0, 2.0),
                      PROL_DROITE="CONSTANT")
whole = DEFI_CONSTANTE(VALE=1.0)
times = DEFI_LIST_REEL(DEBUT=0.0, INTERVALLE=_F(JUSQU_A=2.0, NOMBRE=4))
some = DEFI_LIST_REEL(DEBUT=0.0)
steps = DEFI_LIST_INST(DEFI_LIST={steps})
{solver}(MODELE=model, CHAM_MATER=fields, COMPORTEMENT=_F(RELATION="ELAS"), {end},
         EXCIT=(_F(CHARGE=held, FONC_MULT=rise, COEF_MULT=1.0), _F(CHARGE=held, FONC_MULT={curve})))
"""
ROWS = [(name, key, rule) for name, one in COMMANDS.items() for key, rule in one.options.items()]


def written(folder, name, key):
    """A command, or a factor of one, with one keyword."""
    word, _, value = key.partition("=")
    value = "OTHER" if value == "*" else value or "SOME"
    word = "NOVEL" if word == "*" else word
    command, _, factor = name.partition("/")
    inner = f"{word}={value!r}"
    path = folder / "one.comm"
    path.write_text(f"a = {command}({f'{factor}=_F({inner})' if factor else inner})\n")
    return path, word, factor


@pytest.mark.parametrize(
    ("name", "key", "rule"), ROWS, ids=[f"{name} {key}" for name, key, _ in ROWS]
)
def test_a_keyword_has_its_outcome(name, key, rule, tmp_path):
    path, word, factor = written(tmp_path, name, key)
    (command,) = commands_of(path)
    said = [
        left
        for left in command.unread
        if left.keyword == name.replace("/", " ") and left.why.startswith(word)
    ]
    assert bool(said) == (rule.outcome in (AS_TODO, OUT)) == bool(rule.why)
    inner = command.factors(factor) if factor else (command,)
    assert any(word in one.words for one in inner) == (rule.outcome == READ)
    assert all(left.source == "one.comm:1" for left in said)


@pytest.mark.parametrize(
    "name", [name for name, one in COMMANDS.items() if one.options and "*" not in one.options]
)
def test_a_keyword_that_nobody_knows_is_named(name, tmp_path):
    (command,) = commands_of(written(tmp_path, name, "NOVEL")[0])
    assert [left.why for left in command.unread] == ["NOVEL=SOME: it is not read"]


def test_keywords_that_are_read_are_looked_up(tmp_path, monkeypatch):
    """Files with all of them, in which readers note what they ask for."""
    asked = set()
    plain = comm_commands.admitted

    def recorded(command, name):
        found = plain(command, name)
        return replace(found, words=Recorded(found.words, name, asked))

    monkeypatch.setattr(comm_commands, "admitted", recorded)
    text = blocks("")
    (tmp_path / "run.inp").write_text(text[: text.index("*MATERIAL")])
    of_steps = "CONTACT=touch, INCREMENT=_F(LIST_INST={}{})"
    for kind, solver, end, steps, curve in (
        (
            "AFFE_CHAR_MECA",
            "STAT_NON_LINE",
            of_steps.format("steps", ""),
            "_F(LIST_INST=times)",
            "twice",
        ),
        (
            "AFFE_CHAR_MECA",
            "STAT_NON_LINE",
            of_steps.format("steps", ", INST_FIN=1.0"),
            "_F(VALE=(0.0, 1.0))",
            "whole",
        ),
        (
            "AFFE_CHAR_MECA",
            "STAT_NON_LINE",
            of_steps.format("steps", ""),
            "_F(VALE=(0.0, 1.0))",
            "twice",
        ),
        (
            "AFFE_CHAR_MECA",
            "STAT_NON_LINE",
            of_steps.format("some", ""),
            "_F(VALE=(0.0, 1.0))",
            "twice",
        ),
        ("AFFE_CHAR_CINE", "MECA_STATIQUE", "INST_FIN=1.0, LIST_INST=times", "None", "whole"),
        ("AFFE_CHAR_CINE", "MECA_STATIQUE", "INST=1.0", "None", "whole"),
        ("AFFE_CHAR_CINE", "MECA_STATIQUE", "LIST_INST=times", "None", "whole"),
    ):
        words = ALL.replace("{kind}", kind).replace("{solver}", solver).replace("{end}", end)
        (tmp_path / "run.comm").write_text(
            words.replace("{steps}", steps).replace("{curve}", curve)
        )
        deck_of(tmp_path / "run.comm")
    read = {(name, key.partition("=")[0]) for name, key, rule in ROWS if rule.outcome == READ}
    # behaviour is only looked at by the table: there is one law that is read
    assert read - asked == {(one, "COMPORTEMENT") for one in ("STAT_NON_LINE", "MECA_STATIQUE")}


def test_the_documentation_has_the_table():
    """Write the rows that this has into docs/decks.md if it fails."""
    assert "\n".join(rows_of_docs(COMMANDS, "")) in DOCS.read_text("utf-8")
