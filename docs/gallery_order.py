"""Demos of the gallery, in the order in which its page shows them."""

from pathlib import Path

GALLERY = (
    "flange",
    "bolted_joint",
    "bolt_preload",
    "your_scene",
    "sphere_on_block",
    "fretting",
    "sliding_punch",
    "fuel_rod",
    "press_fit",
    "held_by_contact",
)


def place(name: str) -> int:
    """Place of a script in the gallery, from 0 on; behind all others for one that is not in it.

    Args:
        name: file name of the script.
    """
    stem = Path(name).stem
    return GALLERY.index(stem) if stem in GALLERY else len(GALLERY)
