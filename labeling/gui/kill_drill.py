"""Kills a labeling server again and again: `python -m codediffuser.labeling.gui.kill_drill RUN`.

A child process labels a copy of the run at random, as two operators at once, and says before each
action what it is about to do and after it that the window would now show "saved". It is killed at
a random moment; then the files must hold everything that it had said was saved. The next child
goes on from there.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tyro

from codediffuser.datagen.episode_format import EPISODES
from codediffuser.errors import BelowTargetError, CodeDiffuserError, StaleLabelError
from codediffuser.labeling.gui.bench import unlabeled_copy
from codediffuser.labeling.gui.desk import Desk
from codediffuser.labeling.gui.draft import complete
from codediffuser.labeling.gui.journal import Journal
from codediffuser.labeling.gui.session import Session
from codediffuser.labeling.store import load_document, read_targets

OPERATORS = ("ada", "bob")
MODULE = "codediffuser.labeling.gui.kill_drill"
MOST_LINES = 60
"""A child is killed somewhere after so many lines at most, however slow the machine is."""

LONGEST_S = 0.05
"""And up to so long after that line, so that the kill meets any moment of an action."""


@dataclass(slots=True)
class Drill:
    """What came of it."""

    kills: int = 0
    acknowledged: int = 0
    """Actions that were said to be saved."""
    submitted: int = 0
    """Those of them that were submitted labels."""
    lost: list[str] = field(default_factory=list)
    """What was said to be saved and is not there."""


def drill(run: tyro.conf.Positional[Path], *, kills: int = 50, seed: int = 0) -> Drill:
    """Kill a labeling process at random moments and look for what is lost.

    Args:
        run: Run with simulated episodes; it is copied.
        kills: How often.
        seed: Of the moments and of the actions.

    Raises:
        EpisodeError: The run has no episodes.
    """
    rng, result = random.Random(seed), Drill()
    with tempfile.TemporaryDirectory() as scratch:
        copy = unlabeled_copy(run, Path(scratch), 4)
        for number in range(kills):
            said = list(_child_killed(copy, rng, f"{seed}-{number}"))
            result.kills += 1
            result.acknowledged += sum(line["said"] == "ack" for line in said)
            result.submitted += sum(
                line["said"] == "ack" and line["revision"] > 0 for line in said
            )  # fmt: skip
            result.lost += _lost(copy, said)
    return result


def _child_killed(run: Path, rng: random.Random, seed: str) -> Iterator[dict[str, Any]]:
    """What a child said from its start until it was killed."""
    child = subprocess.Popen(
        [sys.executable, "-m", MODULE, "--work", str(run), seed],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None
    lines = [child.stdout.readline() for _ in range(rng.randint(1, MOST_LINES))]
    time.sleep(rng.uniform(0, LONGEST_S))
    os.kill(child.pid, signal.SIGKILL)
    lines += child.stdout.readlines()
    child.wait()
    child.stdout.close()
    for line in lines:
        # The last line may be torn; what was not said whole was not said.
        if line.endswith("\n"):
            yield json.loads(line)


def _lost(run: Path, said: list[dict[str, Any]]) -> Iterator[str]:
    """What was acknowledged and cannot be found on disk."""
    journals = {name: Journal(run, name) for name in OPERATORS}
    allowed: dict[tuple[str, str, str], list[list[Any]]] = {}
    for line in said:
        key = (line["operator"], line["tab"], line["episode"])
        if line["said"] == "ack":
            allowed[key] = [line["selection"]]
            if line["revision"] > 0 and not _has_revision(run, line):
                yield f"labels: {line}"
        elif line["selection"] is not None:
            # Begun and perhaps done: both what was there and what was meant are right.
            allowed.setdefault(key, []).append(line["selection"])
    for (operator, tab, episode), selections in allowed.items():
        entry = journals[operator].entries.get((tab, episode))
        found = [list(item) for item in entry.draft.selection] if entry else []
        if found not in selections:
            yield f"draft of {operator} in {episode}: {found}, expected one of {selections}"
    for journal in journals.values():
        journal.close()


def _has_revision(run: Path, line: dict[str, Any]) -> bool:
    folder = run / EPISODES / line["episode"]
    document = load_document(folder)
    for revision in document.revisions() if document else ():
        if revision.revision == line["revision"]:
            read_targets(folder, revision.labels)
            said = sorted([e.role, e.instance_id] for e in revision.labels)
            by = revision.saved.by if revision.saved else ""
            return said == sorted(line["selection"]) and by == line["operator"]
    return False


def _work(run: Path, seed: str) -> None:
    """Label at random as every operator at once, until killed."""
    desk = Desk(run)
    lock = threading.Lock()

    def say(**line: Any) -> None:
        with lock:
            sys.stdout.write(json.dumps(line) + "\n")
            sys.stdout.flush()

    def operate(operator: str) -> None:
        session, rng = Session(desk, operator), random.Random(f"{seed}-{operator}")
        session.filter = "all"
        session.start()
        while True:
            _random_action(session, rng, say)

    for name in OPERATORS[1:]:
        threading.Thread(target=operate, args=(name,), daemon=True).start()
    operate(OPERATORS[0])


def _random_action(session: Session, rng: random.Random, say: Any) -> None:
    assert session.scene is not None
    who = {"operator": session.operator, "tab": session.tab, "episode": session.scene.id}
    action = rng.choice(["toggle"] * 6 + ["undo", "redo", "submit", "submit", "submit", "next"])
    if action == "next":
        session.next()
        return
    instance = rng.choice(session.scene.instances)
    meant = {
        "toggle": session.after_toggle(instance),
        "undo": session.draft.undo().selection,
        "redo": session.draft.redo().selection,
        "submit": session.draft.selection,
    }[action]
    say(said="try", selection=meant, revision=0, **who)
    revision = 0
    try:
        if action == "toggle":
            session.toggle(instance)
        elif action == "submit" and complete(session.draft, session.needs):
            revision = session.submit().revision
        elif action in ("undo", "redo"):
            (session.undo if action == "undo" else session.redo)()
    except StaleLabelError:
        revision = session.keep_mine().revision
    except CodeDiffuserError as error:
        raise SystemExit(f"{who}: {error}") from None
    # The same labels again make no new revision, so the number is not always this operator's.
    mine = session.document is not None and session.document.saved is not None
    mine = mine and session.document.saved.by == session.operator  # type: ignore[union-attr]
    say(said="ack", selection=session.draft.selection, revision=revision * mine, **who)


def main() -> None:
    """Print how many kills and actions there were and what was lost; exit with 3 when any was."""
    if sys.argv[1:2] == ["--work"]:
        _work(Path(sys.argv[2]), sys.argv[3])
        return
    began = time.monotonic()
    result = tyro.cli(drill)
    sys.stdout.write(
        f"{result.kills} kills in {time.monotonic() - began:.0f} s: {result.acknowledged} "
        f"acknowledged actions, {result.submitted} of them submitted labels, "
        f"{len(result.lost)} lost\n" + "".join(f"  {line}\n" for line in result.lost)
    )
    if result.lost:
        sys.exit(BelowTargetError.exit_code)


if __name__ == "__main__":
    main()
