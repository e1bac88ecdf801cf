"""`codediffuser doctor`: whether this machine can do the work, tried and not guessed."""

from __future__ import annotations

from dataclasses import dataclass

from rich.table import Table

from codediffuser.errors import SetupError
from codediffuser.verbs.verb import Verb, console, print_table


@dataclass(kw_only=True)
class Doctor(Verb):
    """Check every requirement by using it, and print the command that mends what is missing."""

    def run(self) -> None:
        """Print a table; an unmet requirement is an error."""
        from codediffuser.doctor import run_checks

        table = Table("", "requirement", "found", "mend it with", show_edge=False)
        broken = []
        for result in run_checks():
            console.print(f"checked {result.name}", style="dim")
            mark = (
                "[green]ok[/]"
                if result.ok
                else "[red]no[/]"
                if result.required
                else "[yellow]--[/]"
            )
            table.add_row(mark, result.name, result.detail, "" if result.ok else result.remedy)
            if result.required and not result.ok:
                broken.append(result.name)
        print_table(table)
        if broken:
            raise SetupError(f"this machine lacks: {', '.join(broken)}; see the last column above")
