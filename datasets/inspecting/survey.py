"""What there is to know of a run or a dataset without looking at its pictures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

SUCCESS = "success"
NOT_RECORDED = "not recorded"


@dataclass(frozen=True, slots=True)
class LabelFacts:
    """One label of an episode."""

    role: str
    category: str
    source: str
    """`simulator`, `human`, `features` or `program`."""
    num_points: int


@dataclass(frozen=True, slots=True)
class EpisodeFacts:
    """One episode."""

    id: str
    task: str
    instruction: str
    frames: int
    hz: float
    outcome: str = SUCCESS
    """`success`, or in which way it failed."""
    source: str = NOT_RECORDED
    kind: str = NOT_RECORDED
    """Kind of the instruction: how much it leaves open."""
    split: str = NOT_RECORDED
    labels: tuple[LabelFacts, ...] = ()
    start_m: tuple[float, float] | None = None
    """Where the object that is picked stands in the world at first, x and y."""
    target_m: tuple[float, float] | None = None
    """Where it is to go."""
    code: str = NOT_RECORDED
    """Version and commit of the code that wrote it."""


@dataclass(frozen=True, slots=True)
class FeatureFacts:
    """One thing that every frame holds."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    note: str = ""


@dataclass(frozen=True, slots=True)
class Motion:
    """State and actions of some episodes, each brought to the same number of moments."""

    state: np.ndarray
    """(E, M, n) float32."""
    action: np.ndarray
    """(E, M, m) float32."""
    state_names: tuple[str, ...]
    action_names: tuple[str, ...]
    attention: np.ndarray | None = None
    """(E, M, R) float32: attended points of each role; None where clouds are not stored."""


@dataclass(frozen=True, slots=True)
class Survey:
    """A run or a dataset."""

    path: Path
    what: Literal["run", "LeRobot dataset"]
    episodes: tuple[EpisodeFacts, ...]
    features: tuple[FeatureFacts, ...]
    cameras: Mapping[str, str]
    """What each camera gives, by name."""
    bytes_by_part: Mapping[str, int]
    """Size on disk."""
    failed: Mapping[str, int] = field(default_factory=dict)
    """Attempts that left no episode here, by reason."""
    remarks: tuple[str, ...] = ()
    """What could not be read, in words."""

    @property
    def frames(self) -> int:
        """Frames of all episodes."""
        return sum(e.frames for e in self.episodes)

    @property
    def hours(self) -> float:
        """Time that the episodes last."""
        return sum(e.frames / e.hz for e in self.episodes) / 3600

    @property
    def outcomes(self) -> dict[str, int]:
        """Successes and failures, those that left no episode included."""
        counts = Counter(e.outcome for e in self.episodes)
        counts.update(self.failed)
        return _sorted(counts, first=SUCCESS)

    def count(
        self, attribute: Literal["task", "kind", "split", "source", "code"]
    ) -> dict[str, int]:
        """How many episodes have which value, the most frequent first."""
        return _sorted(Counter(str(getattr(e, attribute)) for e in self.episodes))

    @property
    def instructions(self) -> dict[str, int]:
        """How many episodes have which sentence."""
        return _sorted(Counter(e.instruction for e in self.episodes))

    @property
    def labels(self) -> dict[str, dict[str, int]]:
        """How many labels come from which source, by role and category."""
        found: dict[str, Counter[str]] = {}
        for label in (label for e in self.episodes for label in e.labels):
            found.setdefault(f"{label.role} {label.category}", Counter())[label.source] += 1
        return {name: _sorted(counts) for name, counts in sorted(found.items())}

    @property
    def unlabeled(self) -> int:
        """Episodes without labels."""
        return sum(not e.labels for e in self.episodes)


def bytes_below(paths: Iterable[Path]) -> int:
    """Bytes of files and of all files in folders."""
    total = 0
    for path in paths:
        files = path.rglob("*") if path.is_dir() else (path,)
        total += sum(file.stat().st_size for file in files if file.is_file())
    return total


def resample(values: np.ndarray, moments: int) -> np.ndarray:
    """Rows (T, n) at evenly spread moments, (moments, n); the nearest row, none is invented."""
    rows = np.linspace(0, len(values) - 1, moments).round().astype(int)
    return np.asarray(values[rows], dtype=np.float32)


def spread(count: int, most: int) -> list[int]:
    """At most `most` positions out of `count`, evenly spread, first and last among them."""
    return sorted({int(i) for i in np.linspace(0, count - 1, min(count, most)).round()})


def _sorted(counts: Counter[str], first: str = "") -> dict[str, int]:
    order = sorted(counts.items(), key=lambda item: (item[0] != first, -item[1], item[0]))
    return dict(order)
