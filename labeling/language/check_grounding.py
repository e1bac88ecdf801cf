"""How many sampled instructions the built-in composer grounds right, by slackness kind.

Run as `python -m codediffuser.labeling.language.check_grounding --task stow_book`; exit code 3 when
one is wrong. Right is an answer among the pairs of object and place that the instruction allows;
these come from the task's own phrases, which share no line with the composer. Sentences are those
that ship, seen and unseen ones, spread evenly.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import tyro

from codediffuser.datagen.sampling_settings import SamplingSettings
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_sampler import SceneSource
from codediffuser.datagen.task import get_task
from codediffuser.errors import BelowTargetError, CodeDiffuserError
from codediffuser.labeling.language.grounding import ground
from codediffuser.labeling.language.sandbox import Limits
from codediffuser.labeling.language.simulated import simulated_provider

LIMITS = Limits(seconds=10.0)
"""A program takes milliseconds; the margin keeps results the same on a machine that is busy."""


@dataclass(frozen=True, slots=True)
class GroundedScene:
    """What came of one instruction."""

    scene: SceneSpec
    answer: tuple[str, str] | None
    """Ids of object and place; None when there was none."""
    reason: str
    """Why there was none; empty otherwise."""

    @property
    def right(self) -> bool:
        """Whether the instruction allows the answer."""
        return self.answer in self.scene.instruction.pairs


def ground_scenes(
    task: str, *, scenes: int = 200, variant: str = "sim", seed: int = 0
) -> Iterator[GroundedScene]:
    """Sample scenes and ground the instruction of each.

    Args:
        task: Registered task.
        scenes: How many.
        variant: Which ranges of the task's YAML to draw from.
        seed: Root seed of the scenes.
    """
    chosen = get_task(task)
    settings = SamplingSettings(root_seed=seed, variant=variant, stratify=("template",))
    source = SceneSource(chosen, settings)
    for index in range(scenes):
        scene = source.draw(index)
        try:
            found = ground(
                scene.instruction.text, simulated_provider(scene, task=chosen), limits=LIMITS
            )
        except CodeDiffuserError as error:
            yield GroundedScene(scene, None, str(error))
        else:
            yield GroundedScene(scene, (found.target("pick"), found.target("place")), "")


def main() -> int:
    """Print right answers by kind, and every wrong one; 3 when there is one."""
    asked: Counter[str] = Counter()
    right: Counter[str] = Counter()
    for result in tyro.cli(ground_scenes):
        said = result.scene.instruction
        for kind in (said.kind, f"{said.template_split} sentences", "all"):
            asked[kind] += 1
            right[kind] += result.right
        if not result.right:
            sys.stdout.write(
                f"{result.scene.scene_id} {said.text!r}: {result.reason or result.answer}, allowed "
                f"{', '.join(' > '.join(pair) for pair in said.pairs)}\n"
            )
    for kind, count in sorted(asked.items()):
        sys.stdout.write(f"{kind}: {right[kind]} of {count}\n")
    return 0 if right == asked else BelowTargetError.exit_code


if __name__ == "__main__":
    raise SystemExit(main())
