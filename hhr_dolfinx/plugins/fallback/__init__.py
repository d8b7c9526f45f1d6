"""Reduced models with a fallback: the full model answers queries whose error may be too large."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="fallback",
    public={"hhr_dolfinx.plugins.fallback.model": "FallbackModel"},
    methods={"safe_model": "hhr_dolfinx.plugins.fallback.model:safe_model"},
)
