"""Modules that compositions load when they need them, loaded once for all child processes."""

from contextlib import suppress
from importlib import import_module

import compose_toys
import compose_verbs  # noqa: F401 (what children run)

from hhr_dolfinx.plugins.conformance.draft import switches

CORE = (
    "full_order.outputs",
    "models.bound",
    "models.gradient",
    "models.many",
    "models.reduced",
    "online.model_file",
    "reduction.build",
    "reduction.exact",
    "study.condensing",
    "study.training.train",
)
PLUGINS = (
    "differences.offline",
    "differences.outputs",
    "exporters.c_header",
    "friction.steps",
    "inelastic.condense_flow",
    "inelastic.full_order",
    "moduli.condense",
    "moduli.interpolate_reduced",
    "pages.page",
    "pages.scenery_of",
    "small_strains.guard",
)
OURS = [f"hhr_dolfinx.{name}" for name in (*CORE, *(f"plugins.{one}" for one in PLUGINS))]
for name in ("scipy.stats", *OURS):
    with suppress(ImportError):  # of a plug-in that was deleted
        import_module(name)
with compose_toys.registered():
    KNOWN = switches()
