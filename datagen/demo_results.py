"""What `demo` records of each scene, and its summary of a run."""

from __future__ import annotations

import os
import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from codediffuser.datagen.episode_format import EPISODES, ConditionRecord, EpisodeManifest
from codediffuser.schema import Document

FAILURES = "failures"
SUMMARY = "demo_summary.json"


class DemoFailure(Document):
    """Why a scene has no episode (`RUN/episodes/failures/<id>.json`)."""

    KIND: ClassVar[str] = "demo_failure"
    VERSION: ClassVar[int] = 1

    scene_id: str
    scene_sha256: str
    """Of the scene file that was tried; another file is tried anew."""
    cause: Literal["expert", "process"]
    """`expert`: the script failed, and would again. `process`: its process died or hung."""
    phase: str
    """Phase in which it went wrong: `grasp:missed`, ..., or `process:hung`, `process:died`,
    `process:error`."""
    reason: str
    conditions: tuple[ConditionRecord, ...] = ()
    steps: int = 0
    tries: int = 1

    @property
    def repeatable(self) -> bool:
        """Whether trying again must end the same way."""
        return self.cause == "expert"


def failure_path(run: Path, scene_id: str) -> Path:
    """Where the failure of a scene is recorded."""
    return run / EPISODES / FAILURES / f"{scene_id}.json"


@dataclass(frozen=True, slots=True)
class DemoResult:
    """What came of one scene, in this call or an earlier one."""

    scene_id: str
    success: bool
    earlier: bool = False
    """Found on disk: nothing was done now."""
    phase: str = ""
    reason: str = ""
    steps: int = 0
    """Control steps of the episode, or up to the failure."""
    cameras: int = 0
    bytes: int = 0
    """Size of the episode's files."""
    physics_s: float = 0.0
    render_s: float = 0.0
    write_s: float = 0.0
    """Compressing, writing and reading back."""
    tries: int = 1
    rss_mb: float = 0.0
    """Memory of the process after this scene."""

    @property
    def note(self) -> str:
        """A few words for a progress bar."""
        if self.success:
            return f"{self.scene_id} {self.bytes / 1e6:.1f} MB" if self.bytes else self.scene_id
        return f"{self.scene_id} failed: {self.phase or self.reason}"

    @classmethod
    def of_episode(cls, manifest: EpisodeManifest, **more: float | bool) -> DemoResult:
        """Result of an episode that is on disk."""
        return cls(
            scene_id=manifest.id,
            success=manifest.success,
            steps=manifest.frames,
            cameras=len(manifest.cameras),
            bytes=sum(f.bytes for f in manifest.files.values()),
            **more,  # type: ignore[arg-type]
        )

    @classmethod
    def of_physics(cls, scene_id: str, steps: int, **more: float | bool) -> DemoResult:
        """Result of a success whose pictures are not drawn yet."""
        return cls(scene_id=scene_id, success=True, steps=steps, **more)  # type: ignore[arg-type]

    @classmethod
    def of_failure(cls, failure: DemoFailure, **more: float | bool) -> DemoResult:
        """Result of a scene without an episode."""
        return cls(
            scene_id=failure.scene_id,
            success=False,
            phase=failure.phase,
            reason=failure.reason,
            steps=failure.steps,
            tries=failure.tries,
            **more,  # type: ignore[arg-type]
        )


class DemoSummary(Document):
    """`RUN/demo_summary.json`: yield of the whole run, and speed of the last call."""

    KIND: ClassVar[str] = "demo_summary"
    VERSION: ClassVar[int] = 2

    scenes: int
    attempts: int
    """Scenes that were tried, with those tried again after their process died or hung."""
    successes: int
    """Scenes that the expert solved."""
    episodes: int
    """Successes that have their pictures."""
    success_rate: float
    """Successes over scenes; 0 without scenes."""
    failures_by_phase: dict[str, int]
    failed_scenes: dict[str, str]
    """Scene id to reason."""
    bytes_per_episode: float
    new_successes: int
    """Made in the last call; what follows is about these."""
    workers: int
    wall_s: float
    physics_s: float
    """Summed over processes, as `render_s` and `write_s`."""
    render_s: float
    write_s: float
    control_steps_per_s: float
    """Of physics, in one process."""
    camera_sets_per_s: float
    """Of rendering, in one process; a set is one picture of every camera."""
    episodes_per_hour: float
    """Successes of the last call, with pictures unless it was physics alone."""
    rss_mb_early: float
    """Median memory of a process over the first fifth of the scenes of the last call."""
    rss_mb_late: float
    """The same over the last fifth."""


def summarize(results: Sequence[DemoResult], *, workers: int, wall_s: float) -> DemoSummary:
    """Count results and derive speeds; a rate without time or episodes is 0.

    Args:
        results: In the order in which they came.
        workers: Processes of the last call.
        wall_s: Its duration.
    """
    good, bad = [r for r in results if r.success], [r for r in results if not r.success]
    drawn = [r for r in good if r.bytes]
    now = [r for r in results if not r.earlier]
    made = [r for r in now if r.success]
    physics_s, render_s = sum(r.physics_s for r in now), sum(r.render_s for r in now)
    memory = [r.rss_mb for r in now if r.rss_mb]
    fifth = max(len(memory) // 5, 1)
    return DemoSummary(
        scenes=len(results),
        attempts=sum(r.tries for r in results),
        successes=len(good),
        episodes=len(drawn),
        success_rate=_ratio(len(good), len(results)),
        failures_by_phase=dict(sorted(Counter(r.phase or "unknown" for r in bad).items())),
        failed_scenes={r.scene_id: r.reason for r in sorted(bad, key=lambda r: r.scene_id)},
        bytes_per_episode=_ratio(sum(r.bytes for r in drawn), len(drawn)),
        new_successes=len(made),
        workers=workers,
        wall_s=wall_s,
        physics_s=physics_s,
        render_s=render_s,
        write_s=sum(r.write_s for r in now),
        control_steps_per_s=_ratio(sum(r.steps for r in now if r.physics_s), physics_s),
        camera_sets_per_s=_ratio(sum(r.steps for r in made if r.render_s), render_s),
        episodes_per_hour=_ratio(3600 * len(made), wall_s),
        rss_mb_early=statistics.median(memory[:fifth]) if memory else 0.0,
        rss_mb_late=statistics.median(memory[-fifth:]) if memory else 0.0,
    )


def report_lines(summary: DemoSummary) -> list[str]:
    """Yield, failure histogram and throughput in words; no speeds when nothing was left to do."""
    s = summary
    lines = [
        f"{s.successes} of {s.scenes} scenes solved ({s.success_rate:.1%}) in {s.attempts} "
        f"attempts; {s.episodes} have their pictures"
    ]
    lines += [f"  failed {count} x {phase}" for phase, count in s.failures_by_phase.items()]
    if s.episodes:
        lines.append(f"{s.bytes_per_episode / 1e6:.1f} MB an episode")
    if s.new_successes:
        lines.append(
            f"{s.new_successes} new in {s.wall_s:.0f} s by {s.workers} workers: "
            f"{s.episodes_per_hour:.0f} an hour"
        )
    if s.scenes and not (s.physics_s or s.render_s or s.write_s):
        lines.append("nothing was left to do; --overwrite makes everything again")
    speeds = []
    if s.control_steps_per_s:
        speeds.append(f"{s.control_steps_per_s:.0f} control steps/s")
    if s.camera_sets_per_s:
        speeds.append(f"{s.camera_sets_per_s:.1f} camera sets/s")
    if speeds:
        lines.append(
            f"in one process: {', '.join(speeds)}; memory {s.rss_mb_early:.0f} MB early, "
            f"{s.rss_mb_late:.0f} MB late"
        )
    return lines


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else 0.0


def resident_mb() -> float:
    """Memory that this process holds now, megabytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
