"""Puts the demos, whose scenes benchmarks measure, where Python finds them."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent.parent / "demos"))
