"""`summary.json` of a set of scenes: how often each level of each factor occurs."""

from __future__ import annotations

import hashlib
from collections import Counter
from typing import ClassVar

import numpy as np

from codediffuser.datagen.instructions.templates import TemplateLibrary
from codediffuser.datagen.sampling_settings import SamplingSettings
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.task import Task
from codediffuser.schema import Document, Strict

SUMMARY_FILE = "summary.json"
BIN_M = 0.02
"""Width of the bins of histograms."""


class Histogram(Strict):
    """Counts of positions along one axis; only bins from the first to the last used one."""

    start_m: float
    """Lower edge of the first bin."""
    bin_m: float
    counts: tuple[int, ...]


class SampleSummary(Document):
    """Coverage of a set of scenes (`schema: codediffuser.sample_summary/1`).

    Kinds, templates and phrases of the library that never occur are listed with 0.
    """

    KIND: ClassVar[str] = "sample_summary"
    VERSION: ClassVar[int] = 1

    task: str
    settings: SamplingSettings
    library: str
    """File name of the sentences."""
    library_sha256: str
    scenes: int
    layouts_drawn: int
    """All attempts, those that did not fit their sentence included."""
    kinds: dict[str, int]
    templates: dict[str, int]
    template_splits: dict[str, int]
    components: dict[str, dict[str, int]]
    """Category to words to how often they are meant, or mentioned as the other one."""
    target_places: dict[str, int]
    picks_x_places: dict[str, int]
    """`<picks> x <places>`: how often."""
    allowed_pairs: dict[str, int]
    """Number of pairs that an instruction allows: how often."""
    target_start_x: Histogram
    """Where the picked object starts, world."""
    target_start_y: Histogram
    waiting_start_x: Histogram
    """Where all objects start that could be picked."""
    waiting_start_y: Histogram


class SummaryBuilder:
    """Counts scenes one by one; the result does not depend on their order."""

    def __init__(self, task: Task, settings: SamplingSettings, library: TemplateLibrary) -> None:
        self._task = task.name
        self._settings = settings
        self._library = library
        self._layouts = 0
        self._scenes = 0
        self._kinds = Counter({kind: 0 for kind in library.kinds})
        self._templates = Counter({t.id: 0 for t in library.templates})
        self._splits: Counter[str] = Counter()
        self._words: dict[str, Counter[str]] = {category: Counter() for category in library.phrases}
        self._targets: Counter[str] = Counter()
        self._ambiguity: Counter[str] = Counter()
        self._pairs: Counter[str] = Counter()
        self._target_bins = (Counter[int](), Counter[int]())
        self._waiting_bins = (Counter[int](), Counter[int]())

    def add(self, scene: SceneSpec) -> None:
        """Count one scene."""
        said = scene.instruction
        self._scenes += 1
        self._layouts += scene.seed.attempt + 1
        self._kinds[said.kind] += 1
        self._templates[said.template_id] += 1
        self._splits[said.template_split] += 1
        for placeholder, words in said.components.items():
            category = placeholder.removeprefix("other_")
            self._words.setdefault(category, Counter())[words] += 1
        self._targets[scene.target.place] += 1
        self._ambiguity[f"{scene.ambiguity.picks} x {scene.ambiguity.places}"] += 1
        self._pairs[f"{len(said.pairs):03d}"] += 1
        for thing in scene.pickable:
            for axis in (0, 1):
                bin_number = int(np.floor(thing.position_m[axis] / BIN_M))
                self._waiting_bins[axis][bin_number] += 1
                if thing.id == scene.target.pick:
                    self._target_bins[axis][bin_number] += 1

    def finish(self) -> SampleSummary:
        """The summary of all scenes that were added."""
        source = self._library.source
        return SampleSummary(
            task=self._task,
            settings=self._settings,
            library=source.name,
            library_sha256=hashlib.sha256(source.read_bytes()).hexdigest(),
            scenes=self._scenes,
            layouts_drawn=self._layouts,
            kinds=_sorted(self._kinds),
            templates=_sorted(self._templates),
            template_splits=_sorted(self._splits),
            components={category: _sorted(words) for category, words in self._words.items()},
            target_places=_sorted(self._targets),
            picks_x_places=_sorted(self._ambiguity),
            allowed_pairs={str(int(key)): n for key, n in _sorted(self._pairs).items()},
            target_start_x=_histogram(self._target_bins[0]),
            target_start_y=_histogram(self._target_bins[1]),
            waiting_start_x=_histogram(self._waiting_bins[0]),
            waiting_start_y=_histogram(self._waiting_bins[1]),
        )


def _sorted(counts: Counter[str]) -> dict[str, int]:
    return {key: counts[key] for key in sorted(counts)}


def _histogram(bins: Counter[int]) -> Histogram:
    if not bins:
        return Histogram(start_m=0.0, bin_m=BIN_M, counts=())
    low, high = min(bins), max(bins)
    return Histogram(
        start_m=round(low * BIN_M, 6),
        bin_m=BIN_M,
        counts=tuple(bins[i] for i in range(low, high + 1)),
    )
