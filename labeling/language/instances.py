"""What language can speak about: instances of categories, and who provides them.

The simulator provides them for now (`simulated.py`); perception will provide the same thing.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from codediffuser.errors import InstructionError, ShapeError
from codediffuser.labeling.label import Role
from codediffuser.labeling.language.vocabulary import Vocabulary
from codediffuser.registry import unknown_name

SMALL_WORDS = frozenset({"a", "an", "any", "some", "the", "that", "this", "one", "ones"})


@dataclass(frozen=True, slots=True)
class Directions:
    """Whose left and right the words mean, as unit vectors on the table (world x and y)."""

    right: tuple[float, float] = (1.0, 0.0)
    front: tuple[float, float] = (0.0, -1.0)
    """Toward the observer."""


@dataclass(frozen=True, slots=True)
class Instance:
    """One thing or place that was found in the scene."""

    id: str
    """Unique within the scene; says nothing about what the thing is."""
    category: str
    name: str
    """What a person would call it: `green battery`."""
    points_world: np.ndarray
    """(N, 3) float32, metres, N >= 1."""
    label: str | None = None
    """What is written on it: the title of a book."""

    def __post_init__(self) -> None:
        points = np.ascontiguousarray(self.points_world, dtype=np.float32)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
            raise ShapeError(
                f"points of instance '{self.id}': expected shape (N, 3) with N >= 1, "
                f"got {points.shape}"
            )
        object.__setattr__(self, "points_world", points)


class InstanceProvider(Protocol):
    """What perception tells the language part about one scene."""

    @property
    def categories(self) -> tuple[str, ...]:
        """Words that programs may ask for: `battery`, `slot`, `crate`."""

    @property
    def roles(self) -> Mapping[Role, str]:
        """Category that is picked, and category that it is placed at."""

    @property
    def directions(self) -> Directions:
        """Whose left and right the words mean."""

    @property
    def vocabulary(self) -> Vocabulary | None:
        """Words of the task, for the built-in composer; None for those of `pack_battery`."""

    def instances(self, category: str) -> Sequence[Instance]:
        """All instances of a category, always in the same order."""

    def find_instance_in_category(self, phrase: str, category: str) -> list[int]:
        """Indices into `instances(category)` of those that look as `phrase` says; may be empty."""


class ListedInstances:
    """A provider over instances that are known already; looks are judged by names and labels.

    Args:
        instances: In the order in which programs see them, ids unique.
        roles: Category that is picked, and category that it is placed at.
        categories: Words that programs may ask for; None takes those of the instances. A category
            may be listed that has no instance.
        directions: Whose left and right the words mean.
        vocabulary: Words of the task; None for those of `pack_battery`.
    """

    def __init__(
        self,
        instances: Sequence[Instance],
        roles: Mapping[Role, str],
        *,
        categories: Sequence[str] | None = None,
        directions: Directions | None = None,
        vocabulary: Vocabulary | None = None,
    ) -> None:
        self._instances = tuple(instances)
        self.roles: Mapping[Role, str] = dict(roles)
        found = categories if categories is not None else [i.category for i in instances]
        self.categories = tuple(dict.fromkeys(found))
        self.directions = directions or Directions()
        self.vocabulary = vocabulary
        ids = [instance.id for instance in self._instances]
        if len(set(ids)) != len(ids):
            raise ValueError(f"instance ids are used twice: {sorted(ids)}")

    def instances(self, category: str) -> tuple[Instance, ...]:
        """All instances of a category in the order they were given.

        Raises:
            InstructionError: No such category.
        """
        if category not in self.categories:
            raise InstructionError(unknown_name("category", category, list(self.categories)))
        return tuple(i for i in self._instances if i.category == category)

    def find_instance_in_category(self, phrase: str, category: str) -> list[int]:
        """Indices of the instances whose name, or label, holds every telling word of the phrase."""
        wanted = _words(phrase) - SMALL_WORDS - _words(category)
        return [
            index
            for index, instance in enumerate(self.instances(category))
            if wanted <= _words(instance.name) or wanted <= _words(instance.label or "")
        ]


def describe_instances(provider: InstanceProvider) -> str:
    """Say what a scene holds, in one line for messages."""
    parts = []
    for category in provider.categories:
        found = provider.instances(category)
        each = [_describe(instance) for instance in found]
        parts.append(f"{len(found)} {category}" + (f" ({', '.join(each)})" if each else ""))
    return "; ".join(parts) or "nothing"


def _describe(instance: Instance) -> str:
    x, y = instance.points_world.mean(axis=0)[:2]
    called = f"{instance.name} {instance.label or ''}".strip()
    name = f"{instance.id}, {called}," if called != instance.category else instance.id
    return f"{name} at x {x:.2f} y {y:.2f}"


def _words(text: str) -> set[str]:
    return set(re.findall(r"[a-z0-9]+", text.lower()))
