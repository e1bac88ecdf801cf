"""`codediffuser VERB ...`: parse, call one function, print the result's path last.

Exit codes: 0 done; 1 a bug of ours; 2 an error that the user can mend, told in one line;
3 finished, but below the success that was asked for; 130 interrupted.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Sequence
from typing import Annotated, Any, Union

# One torch and BLAS thread a process unless the user says otherwise: the stages scale by processes,
# and on few cores several threads that wait for each other are slower than one.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import tyro

from codediffuser.errors import CodeDiffuserError
from codediffuser.verbs import VERBS, Verb
from codediffuser.verbs.verb import console

DESCRIPTION = """Demonstrations, attention labels and policies for robots that follow language.

The pipeline: sample -> demo -> label -> convert -> train -> eval. Each verb reads and writes one
run folder and continues where an earlier call was cut off. `codediffuser quickstart` runs them all.
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the console script."""
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    verb = parse(arguments)
    logging.basicConfig(
        level=logging.DEBUG if verb.debug else logging.WARNING,
        format="%(levelname)s %(name)s: %(message)s",
    )
    try:
        result = verb.run()
    except CodeDiffuserError as error:
        if verb.debug:
            raise
        console.print(f"[bold red]{type(error).__name__}[/]: ", end="")
        console.print(str(error), markup=False, soft_wrap=True)
        return error.exit_code
    except KeyboardInterrupt:
        console.print("Interrupted. What is written is whole; run the same command to continue.")
        return 130
    if result is not None:
        sys.stdout.write(f"{result}\n")
    return 0


def summary(verb: type[Verb]) -> str:
    """First sentence of a verb's own help."""
    return (verb.__doc__ or "").split("\n\n")[0]


def parse(arguments: Sequence[str] | None = None) -> Verb:
    """Turn command-line words into a verb with its options; exits with 2 on unknown words."""
    choices: Any = Union[  # noqa: UP007  built from a table
        tuple(
            Annotated[cls, tyro.conf.subcommand(name, description=summary(cls))]
            for name, cls in VERBS.items()
        )
    ]
    verb: Verb = tyro.cli(
        choices,
        args=arguments,
        prog="codediffuser",
        description=DESCRIPTION,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
    )
    return verb


if __name__ == "__main__":
    main()
