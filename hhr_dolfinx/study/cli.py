"""What every demo script shares: its options, its console, its progress bars."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path

from rich.console import Console
from rich.progress import track


def demo_parser(name: str, description: str) -> argparse.ArgumentParser:
    """Parser with ``--out``, ``--quick`` and ``--seed``."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--out", type=Path, default=Path("out") / name, help="folder of the results (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="fewer points and queries, for a first look and for tests")
    parser.add_argument("--seed", type=int, default=1, help="seed of random test points (%(default)s)")
    return parser


def progress_bars(console: Console) -> Callable[[str], Callable[[Iterable], Iterable]]:
    """Progress bars by label for :func:`hhr_dolfinx.study.study.run_study`."""
    return lambda label: lambda items: track(items, description=f"{label:10}", console=console, transient=True)
