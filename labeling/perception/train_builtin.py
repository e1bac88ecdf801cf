"""Trains the network of the `builtin` features on renders of all tasks.

`python -m codediffuser.labeling.perception.train_builtin SAMPLES` draws what is missing in the
folder SAMPLES, trains, and writes weights with a card that says how they were made. The shipped
weights are the result of that command without options.
"""

from __future__ import annotations

import dataclasses
import logging
import shlex
import sys
import time
from pathlib import Path
from typing import Annotated

import tyro

from codediffuser.datagen.task import TASKS, get_task
from codediffuser.labeling.label import utc_now
from codediffuser.labeling.perception.builtin import (
    WEIGHTS,
    Card,
    card_path,
    load_network,
    save_weights,
)
from codediffuser.labeling.perception.builtin_samples import Sample, draw_samples
from codediffuser.labeling.perception.builtin_targets import CATEGORIES

_log = logging.getLogger(__name__)

HELD_OUT = 20
"""One scene in so many is left out, to score the network on."""
REPORT_EVERY = 50
MIN_COSINE = 0.15
"""Nearly all points of the workspace lie nearer to some reference than this; one that does not is
like nothing that was trained on. Between categories and background the nearest decides."""


def train_builtin(
    samples: Annotated[Path, tyro.conf.Positional],
    *,
    out: Path = WEIGHTS,
    scenes: int = 200,
    steps: int = 2400,
    learning_rate: float = 3e-3,
    start: Path | None = None,
    seed: int = 0,
) -> Card:
    """Train the built-in network.

    Args:
        samples: Folder of drawn scenes, about 6 MB each; what is there already is used.
        out: File of weights; the card lies beside it.
        scenes: Scenes of each task.
        steps: Of training, about 0.4 s each on one core.
        learning_rate: At its peak.
        start: Weights to go on from, best with another seed; None begins anew.
        seed: Of training; scenes are always the same ones.
    """
    import torch

    from codediffuser.labeling.perception.builtin_network import BuiltinNetwork
    from codediffuser.labeling.perception.builtin_training import TrainingConfig, score, train

    tasks = _tasks()
    files = []
    for file in draw_samples(samples, tasks, range(scenes)):
        files.append(file)
        if len(files) % REPORT_EVERY == 0:
            _log.info("%d of %d scenes are drawn", len(files), scenes * len(tasks))
    held_out = [f for n, f in enumerate(files) if n % HELD_OUT == HELD_OUT - 1]
    trained = [Sample.load(f) for f in files if f not in held_out]
    torch.set_num_threads(1)  # more change the last bits, and with them the weights
    torch.manual_seed(seed)
    network = BuiltinNetwork(len(CATEGORIES)) if start is None else load_network(start)
    config = TrainingConfig(steps=steps, learning_rate=learning_rate, seed=seed)
    started = time.process_time()
    for now in train(network, trained, config):
        if now.step % REPORT_EVERY == 0:
            _log.info("step %d of %d: categories %.4f, votes %.4f", now.step, steps,
                      now.category_loss, now.vote_loss)  # fmt: skip
    minutes = (time.process_time() - started) / 60
    scores = score(network, [Sample.load(f) for f in held_out])
    card = Card(
        categories=CATEGORIES,
        min_cosine=MIN_COSINE,
        sha256=save_weights(network, out),
        command=shlex.join(["python", "-m", __spec__.name, *sys.argv[1:]]),
        recipe=dataclasses.asdict(config),
        scenes={**dict.fromkeys(tasks, scenes), "held_out": len(held_out)},
        made_at=utc_now(),
        minutes=round(minutes, 1),
        scores=scores,
    )
    card.save(card_path(out))
    return card


def _tasks() -> list[str]:
    """Tasks that pick and place what the network has a class for."""
    import codediffuser.datagen.tasks  # noqa: F401  fills the registry

    known = set(CATEGORIES)
    tasks = [get_task(name) for name in TASKS.names()]
    return [t.name for t in tasks if {t.pick_category, t.place_category} <= known]


def main() -> None:
    """Train as the command line says and print the scores."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    card = tyro.cli(train_builtin)
    for category, values in card.scores.items():
        words = ", ".join(f"{name} {value:.4f}" for name, value in values.items())
        sys.stdout.write(f"{category}: {words}\n")


if __name__ == "__main__":
    main()
