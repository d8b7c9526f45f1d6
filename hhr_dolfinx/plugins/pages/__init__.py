"""A model as one HTML page that solves in a browser, without Python and without a network."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="pages",
    needs=("stress",),
    optional=("contact_laws", "inelastic", "moduli"),
    public={
        "hhr_dolfinx.plugins.pages.page": "write_model_page",
        "hhr_dolfinx.plugins.pages.scenery": "Scenery",
        "hhr_dolfinx.plugins.pages.scenery_of": "scenery_of",
    },
    commands={"page": "hhr_dolfinx.plugins.pages.commands:page"},
    tools={"mesh_beside": "hhr_dolfinx.plugins.pages.beside:MeshBeside"},
    companions=("hhr_dolfinx.plugins.pages.scenery_of:write_scenery",),
)
