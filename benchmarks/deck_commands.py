"""Commands as a user types them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from hhr_dolfinx.errors import HHRError

COMMAND = "import sys; sys.argv[0] = 'hhr'; from hhr_dolfinx.command.start import main; main()"


def command(folder: Path, *words: str | Path) -> tuple[bool, str]:
    """Run a command in a folder as a user does: whether it ended well, and what it said."""
    line = [sys.executable, "-c", COMMAND, *map(str, words)]
    done = subprocess.run(line, capture_output=True, text=True, cwd=folder)
    foreign = "Traceback" in done.stderr
    return done.returncode == 0, ("FOREIGN " if foreign else "") + done.stdout + done.stderr


def said(folder: Path, *words: str | Path) -> str:
    """Text of a command that ends well; HHRError with its text for one that refuses."""
    well, text = command(folder, *words)
    if text.startswith("FOREIGN"):
        raise RuntimeError(text)
    if not well:
        raise HHRError(" ".join(text.split()).rpartition("error: ")[2])
    return text
