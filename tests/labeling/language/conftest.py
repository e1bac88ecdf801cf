"""Scenes and models that tests of the language part share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pytest

from codediffuser.errors import LanguageModelError
from codediffuser.labeling.language.instances import Directions, Instance, ListedInstances
from codediffuser.labeling.language.models import LanguageModel, Prompt

ROLES = {"pick": "battery", "place": "slot"}
SLOT_X = (0.053, 0.011, -0.031, -0.073)
SLOT_Y = (0.222, 0.18, 0.138)
CRATE_LOW, CRATE_HIGH = (-0.10075, 0.10785, 0.0), (0.08075, 0.25215, 0.053)


def box_points(center: Sequence[float], half: Sequence[float] = (0.01, 0.01, 0.02)) -> np.ndarray:
    """Corners of a box: eight points whose mean is the centre."""
    signs = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)]) * 2 - 1
    return (np.array(center) + signs * np.array(half)).astype(np.float32)


def slot_xy(index: int) -> tuple[float, float]:
    """Slot 0 is at the back right, slot 11 at the front left."""
    return SLOT_X[index % 4], SLOT_Y[index // 4]


@pytest.fixture
def box() -> Callable[..., np.ndarray]:
    return box_points


@pytest.fixture
def make_scene() -> Callable[..., ListedInstances]:
    """Build a provider: waiting batteries by position, taken slots by number."""

    def make(
        waiting: Mapping[str, tuple[float, float]] | None = None,
        taken: Sequence[int] = (),
        names: Mapping[str, str] | None = None,
        directions: Directions | None = None,
    ) -> ListedInstances:
        waiting = {"b": (0.0, 0.0)} if waiting is None else waiting
        batteries = {**waiting, **{f"packed_{i}": slot_xy(i) for i in taken}}
        found = [
            Instance(i, "battery", (names or {}).get(i, "green battery"), box_points((*xy, 0.03)))
            for i, xy in batteries.items()
        ]
        found += [
            Instance(f"slot_{i}", "slot", "slot", box_points((*slot_xy(i), 0.025)))
            for i in range(12)
            if i not in taken
        ]
        low, high = np.array(CRATE_LOW), np.array(CRATE_HIGH)
        crate = box_points((low + high) / 2, (high - low) / 2)
        found.append(Instance("crate", "crate", "crate", crate))
        return ListedInstances(
            found, ROLES, categories=("battery", "slot", "crate"), directions=directions
        )

    return make


class ScriptedModel(LanguageModel):
    """Replies what the test wrote, and keeps what it was asked."""

    name = "scripted"

    def __init__(self, replies: Mapping[str, str | Sequence[str]]) -> None:
        self._replies = {k: [v] if isinstance(v, str) else list(v) for k, v in replies.items()}
        self.prompts: list[Prompt] = []

    def reply(self, prompt: Prompt) -> str:
        self.prompts.append(prompt)
        left = self._replies.get(prompt.text)
        if not left:
            raise LanguageModelError(f"the script has no reply to {prompt.text!r}")
        return left.pop(0) if len(left) > 1 else left[0]


@pytest.fixture
def scripted() -> type[ScriptedModel]:
    return ScriptedModel
