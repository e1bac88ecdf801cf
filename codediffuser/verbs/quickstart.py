"""`codediffuser quickstart`: the whole chain, small, on this machine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.progress import TaskID

from codediffuser.verbs.verb import Verb, stage_bars


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

    def run(self) -> Path:
        """Run all stages and return the report."""
        from codediffuser.eval.quickstart import (
            STAGES,
            QuickstartOptions,
            quickstart_report,
            run_quickstart,
        )

        options = QuickstartOptions(workers=self.workers)
        bars: dict[str, TaskID] = {}
        with stage_bars() as progress:
            for now in run_quickstart(self.out, options):
                if now.stage not in bars:
                    number = STAGES.index(now.stage) + 1
                    bars[now.stage] = progress.add_task(
                        f"{number}/{len(STAGES)} {now.stage}", total=now.total, note=""
                    )
                progress.update(bars[now.stage], completed=now.done, total=now.total, note=now.note)
        return quickstart_report(self.out)
