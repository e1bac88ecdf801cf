"""The command line of a measurement: its options, a folder to work in, its result on stdout."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

Options = TypeVar("Options")


def print_measured(options: type[Options], measure: Callable[[Options, Path], object]) -> None:
    """Parse options from the command line, measure, and print what came out.

    Args:
        options: A dataclass; its fields are the options, their docstrings the help.
        measure: Gets the options and an empty folder, which is deleted afterwards. What it returns
            says itself as text.
    """
    import tyro

    chosen = tyro.cli(options)
    with tempfile.TemporaryDirectory(prefix="codediffuser-") as scratch:
        sys.stdout.write(f"{measure(chosen, Path(scratch))}\n")
