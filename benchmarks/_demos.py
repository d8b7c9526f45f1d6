"""Put the demos and the cases of the thesis, whose scenes benchmarks measure, where Python finds
them.
"""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path += [str(HERE.parent / "demos"), str(HERE / "thesis")]
