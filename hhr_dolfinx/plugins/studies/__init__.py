"""Studies: error against run time of the models of a scene, with report, page and pictures."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.studies"

PLUGIN = Plugin(
    name="studies",
    optional=("paths",),
    public={
        f"{_HERE}.settings": "StudySettings View",
        f"{_HERE}.study": "Rival run_study study_scene",
    },
    commands={"study": f"{_HERE}.commands:study", "report": f"{_HERE}.commands:report"},
    tools={"settings": f"{_HERE}.settings:StudySettings"},
)
