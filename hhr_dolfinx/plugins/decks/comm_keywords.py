"""Commands of code_aster and their keywords with the outcomes: the one place that decides what is
read.

Keywords of a factor are those of ``COMMAND/FACTOR``. Readers get the keywords that they read; all
others become TODO lines, unknown ones too.
"""

from __future__ import annotations

from collections.abc import Mapping

from hhr_dolfinx.plugins.decks.keywords import (
    AS_TODO,
    IDLE,
    READ,
    Keyword,
    Rule,
    out_options,
    read_options,
    with_options,
)


def _left(keyword: Keyword, **options: str) -> Keyword:
    return with_options(keyword, AS_TODO, options)


_PLACES = "GROUP_MA|GROUP_NO"
_MESH = "MODELE|MAILLAGE|INFO|DOUBLE_LAGRANGE|TITRE"
_LAW = "its law is not read, and the body is elastic: give hhr.Body a law= in the scene"
_TURNS = "nodes of solids have no rotations: hhr.MeanMotion turns a surface"
_SOME = "all of the group has it: name a group without these"
_LOADS = _left(
    read_options(
        "DDL_IMPO|FACE_IMPO|MECA_IMPO|PRES_REP|FORCE_FACE|FORCE_CONTOUR|FORCE_NODALE|PESANTEUR",
        _MESH,
    ),
    LIAISON_DDL="no counterpart: hhr.Equation in constraints is one",
    LIAISON_UNIF="no counterpart: hhr.Equation in constraints is one",
    LIAISON_SOLIDE="no counterpart: hhr.RigidMotion(SET) in constraints",
    LIAISON_MAIL="no counterpart: hhr.Tie(SLAVE, MASTER) in constraints",
    LIAISON_GROUP="no counterpart: hhr.Tie(SLAVE, MASTER) in constraints",
    ROTATION="no counterpart: hhr.Centrifugal in loads",
    FORCE_INTERNE="no counterpart: hhr.BodyForce in loads",
    CONTACT="no counterpart: write DEFI_CONTACT, or hhr.Mortar(SLAVE, MASTER) in contacts",
)
_FACTORS = {
    "DDL_IMPO": _left(
        read_options(f"{_PLACES}|DX|DY|DZ|LIAISON=ENCASTRE|BLOCAGE=DEPLACEMENT"),
        **dict.fromkeys(("DRX", "DRY", "DRZ"), _TURNS),
    ),
    "FACE_IMPO": read_options(f"{_PLACES}|DX|DY|DZ"),
    "MECA_IMPO": _left(
        read_options(f"{_PLACES}|DX|DY|DZ|LIAISON=ENCASTRE"),
        **dict.fromkeys(("DRX", "DRY", "DRZ"), _TURNS),
    ),
    "PRES_REP": _left(
        read_options(f"{_PLACES}|PRES"), CISA_2D="no counterpart: hhr.Traction in loads"
    ),
    **dict.fromkeys(
        ("FORCE_FACE", "FORCE_CONTOUR", "FORCE_NODALE"), read_options(f"{_PLACES}|FX|FY|FZ")
    ),
    "PESANTEUR": read_options("GRAVITE|DIRECTION|GROUP_MA"),
}
_NUMBERS_OF_SOLVERS = (
    "STOP_SINGULIER|NB_RESOL|NB_ITER_GEOM|NB_ITER_CONT_MAX|NB_ITER_CONT_MULT|"
    "NB_ITER_CONT_CALCULE|NB_ITER_FROT_MAX|ITER_GEOM_MAXI|ITER_CONT_MAXI|ITER_CONT_MULT|"
    "ITER_FROT_MAXI|ITER_CONT_TYPE|RESI_GEOM|RESI_CONT|RESI_FROT|RESI_ABSO|REAC_GEOM|REAC_ITER|"
    "ALGO_RESO_CONT|ALGO_RESO_GEOM|ALGO_RESO_FROT|PRE_COND|RECH_LINEAIRE|COEF_RESI|LISSAGE|"
    "VERI_NORM|GLIS_MAXI|ITER_PRE_MAXI|ITER_GCP_MAXI"
)
_OF_ZONES = (
    "APPARIEMENT|NORMALE|VECT_MAIT|VECT_ESCL|TYPE_PROJECTION|TYPE_PROJ|TYPE_APPA|DIRE_APPA|"
    "TOLE_PROJ_EXT|TOLE_PROJ_INTE|TOLE_APPA|TOLE_INTERP|INTEGRATION|ORDRE_INT|COEF_CONT|"
    "COEF_FROT|COEF_MATR_FROT|ADAPTATION|SEUIL_INIT|GRAND_GLIS|ALGO_CONT|ALGO_FROT|"
    "CONTACT_INIT=INTERPENETRE|CONTACT_INIT=NON|GLISSIERE=NON|RESOLUTION=OUI|VERIFICATION|"
    "GROUP_MA_FOND"
)
_OF_SOLVERS = "MODELE|CHAM_MATER|EXCIT|COMPORTEMENT"
_IDLE_IN_SOLVERS = (
    "INFO|TITRE|NEWTON|CONVERGENCE|SOLVEUR|ARCHIVAGE|RECH_LINEAIRE|METHODE|OPTION|CARA_ELEM|"
    "AFFICHAGE|MESURE|ENERGIE|OBSERVATION|SUIVI_DDL"
)
_FROM_REST = {
    "ETAT_INIT": "bodies begin at rest without stress",
    "PILOTAGE": "loads reach the values of the file: no path is followed beyond a limit load",
    "reuse": (
        "it goes on from the states of an earlier command: here one step from rest leads to the "
        "loads"
    ),
}
_TURNS_OF_FACETS = (
    "ORIE_PEAU|ORIE_PEAU_2D|ORIE_PEAU_3D|ORIE_NORM_COQUE|ORIE_FISSURE|ORIE_SHB|ORIE_LIGNE"
)
HYPOTHESES: Mapping[str, str] = {
    f"{name}{selective}": hypothesis
    for name, hypothesis in (
        ("3D", "solid"),
        ("AXIS", "axisymmetric"),
        ("D_PLAN", "plane_strain"),
        ("C_PLAN", "plane_stress"),
    )
    for selective in ("", "_SI")
}
"""Hypotheses of models by their names; ``_SI`` only integrates the stiffness at fewer points."""
COMMANDS: Mapping[str, Keyword] = {
    "DEFI_MATERIAU": Keyword(
        Rule(READ), {"ELAS": Rule(READ), "INFO": Rule(IDLE), "*": Rule(AS_TODO, _LAW)}
    ),
    "DEFI_MATERIAU/ELAS": read_options("E|NU|ALPHA|RHO"),
    "AFFE_MATERIAU": _left(
        read_options("AFFE", _MESH),
        AFFE_VARC="no counterpart: hhr.ThermalExpansion in loads has a temperature",
        AFFE_COMPOR=_LAW,
    ),
    "AFFE_MATERIAU/AFFE": read_options("GROUP_MA|MATER|TOUT"),
    "AFFE_MODELE": read_options("AFFE", _MESH),
    "AFFE_MODELE/AFFE": _left(
        read_options(
            "|".join(f"MODELISATION={name}" for name in HYPOTHESES), "GROUP_MA|TOUT|PHENOMENE"
        ),
        **{
            "MODELISATION=*": (
                "no counterpart: cells are solids, axisymmetric, or of plane strain or stress"
            )
        },
    ),
    "MODI_MAILLAGE": Keyword(
        Rule(READ),
        {
            **{name: Rule(IDLE) for name in f"{_MESH}|reuse|{_TURNS_OF_FACETS}".split("|")},
            "*": Rule(
                AS_TODO,
                (
                    "it changes the mesh, and here the mesh is that of its file: give the changed "
                    "one, --mesh"
                ),
            ),
        },
    ),
    "DEFI_FONCTION": read_options(
        "NOM_PARA|VALE|ABSCISSE|ORDONNEE|INTERPOL|PROL_DROITE|PROL_GAUCHE",
        "NOM_RESU|VERIF|INFO|TITRE",
    ),
    "DEFI_CONSTANTE": read_options("VALE", "NOM_RESU|INFO|TITRE"),
    "DEFI_LIST_REEL": read_options("DEBUT|VALE|INTERVALLE", "INFO|TITRE"),
    "DEFI_LIST_REEL/INTERVALLE": read_options("JUSQU_A", "NOMBRE|PAS"),
    "DEFI_LIST_INST": read_options("DEFI_LIST", "ECHEC|ADAPTATION|METHODE|INFO|TITRE"),
    "DEFI_LIST_INST/DEFI_LIST": read_options(
        "LIST_INST|VALE", "METHODE|PAS_MINI|PAS_MAXI|NB_PAS_MAXI"
    ),
    **dict.fromkeys(("AFFE_CHAR_MECA", "AFFE_CHAR_CINE"), _LOADS),
    **{
        f"{name}/{kind}": one
        for name in ("AFFE_CHAR_MECA", "AFFE_CHAR_CINE")
        for kind, one in _FACTORS.items()
    },
    "DEFI_CONTACT": out_options(
        read_options("ZONE|FROTTEMENT", f"{_MESH}|FORMULATION|{_NUMBERS_OF_SOLVERS}"),
        {
            "FORMULATION=LIAISON_UNIL": (
                "no counterpart: a condition on one degree of freedom. hhr.Obstacle is a plane"
            )
        },
    ),
    "DEFI_CONTACT/ZONE": out_options(
        _left(
            read_options("GROUP_MA_ESCL|GROUP_MA_MAIT|COULOMB", _OF_ZONES),
            DIST_MAIT="gaps are those of the mesh: hhr.Opening(CONTACT, -DISTANCE) in openings",
            DIST_ESCL="gaps are those of the mesh: hhr.Opening(CONTACT, -DISTANCE) in openings",
            DIST_POUTRE="no counterpart: bodies have cells",
            DIST_COQUE="no counterpart: bodies have cells",
            SANS_GROUP_NO=_SOME,
            SANS_GROUP_MA=_SOME,
            SANS_GROUP_NO_FR=_SOME,
            SANS_GROUP_MA_FR=_SOME,
            DIRE_EXCL_FROT="friction acts in all directions",
            **{
                "GLISSIERE=OUI": (
                    "contacts that closed may open here. hhr.Tie(SLAVE, MASTER) in constraints "
                    "holds them if they do not slide either"
                ),
                "CONTACT_INIT=OUI": "contacts that are closed at first may open",
                "ALGO_CONT=PENALISATION": "contact is hard here, surfaces do not overlap",
                "ALGO_FROT=PENALISATION": "contacts that stick do not slip here",
                "E_N": "contact is hard here, surfaces do not overlap",
                "E_T": "contacts that stick do not slip here",
            },
        ),
        {"RESOLUTION=NON": "it only watches for overlaps: hhr check says where bodies overlap"},
    ),
    "MECA_STATIQUE": _left(
        read_options(f"{_OF_SOLVERS}|INST|LIST_INST|INST_FIN", _IDLE_IN_SOLVERS), **_FROM_REST
    ),
    "STAT_NON_LINE": _left(
        read_options(f"{_OF_SOLVERS}|CONTACT|INCREMENT", _IDLE_IN_SOLVERS), **_FROM_REST
    ),
    "STAT_NON_LINE/INCREMENT": read_options(
        "LIST_INST|INST_FIN", "INST_INIT|NUME_INST_INIT|PRECISION|CRITERE"
    ),
    **dict.fromkeys(
        ("MECA_STATIQUE/EXCIT", "STAT_NON_LINE/EXCIT"),
        _left(
            read_options("CHARGE|FONC_MULT|COEF_MULT", "TYPE_CHARGE=FIXE_CSTE"),
            **{"TYPE_CHARGE=*": "loads keep their directions, and act from rest"},
        ),
    ),
    "STAT_NON_LINE/COMPORTEMENT": _left(
        read_options(
            "",
            "RELATION=ELAS|DEFORMATION=PETIT|TOUT|GROUP_MA|RESI_INTE_RELA|ITER_INTE_MAXI|ALGO_INTE",
        ),
        **{
            "RELATION=*": _LAW,
            "DEFORMATION=*": "large displacements: strains and rotations are small here",
        },
    ),
    **{
        name: Keyword(Rule(IDLE))
        for name in (
            "DEBUT POURSUITE FIN LIRE_MAILLAGE CALC_CHAMP IMPR_RESU "
            "IMPR_TABLE POST_RELEVE_T TEST_RESU TEST_TABLE DEFI_GROUP CREA_TABLE DEFI_FICHIER "
            "DETRUIRE"
        ).split()
    },
}
"""All commands that are known, and their factors; others are TODO lines."""
