"""`codediffuser quickstart`: the whole chain, small, on this machine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from codediffuser.verbs.verb import Verb


@dataclass(kw_only=True)
class Quickstart(Verb):
    """Sample, demonstrate, label, convert, train and evaluate a small pack_battery run.

    Ends within 25 minutes on two cores and prints the path of the report. Running it again
    continues where it was cut off.
    """

    out: Path = Path("runs/quickstart")
    """Run folder."""
    workers: int = 2
    """Processes."""
