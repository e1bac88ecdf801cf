"""What `demo` records of each scene, and its summary of a run."""

from __future__ import annotations

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
    """Phase in which it went wrong: `grasp:missed`, ..."""
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

    @property
    def note(self) -> str:
        """A few words for a progress bar."""
        if self.success:
            return f"{self.scene_id} {self.bytes / 1e6:.1f} MB"
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
    def of_failure(cls, failure: DemoFailure, **more: float | bool) -> DemoResult:
        """Result of a scene without an episode."""
        return cls(
            scene_id=failure.scene_id,
            success=False,
            phase=failure.phase,
            reason=failure.reason,
            steps=failure.steps,
            **more,  # type: ignore[arg-type]
        )


class DemoSummary(Document):
    """`RUN/demo_summary.json`: yield of the whole run, and speed of the last call."""

    KIND: ClassVar[str] = "demo_summary"
    VERSION: ClassVar[int] = 1

    scenes: int
    episodes: int
    success_rate: float
    """Episodes over scenes; 0 without scenes."""
    failures_by_phase: dict[str, int]
    failed_scenes: dict[str, str]
    """Scene id to reason."""
    bytes_per_episode: float
    new_episodes: int
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


def summarize(results: Sequence[DemoResult], *, workers: int, wall_s: float) -> DemoSummary:
    """Count results and derive speeds; a rate without time or episodes is 0."""
    good = [r for r in results if r.success]
    bad = [r for r in results if not r.success]
    now = [r for r in results if not r.earlier]
    made = [r for r in now if r.success]
    physics_s, render_s = sum(r.physics_s for r in now), sum(r.render_s for r in now)
    return DemoSummary(
        scenes=len(results),
        episodes=len(good),
        success_rate=_ratio(len(good), len(results)),
        failures_by_phase=dict(sorted(Counter(r.phase or "unknown" for r in bad).items())),
        failed_scenes={r.scene_id: r.reason for r in sorted(bad, key=lambda r: r.scene_id)},
        bytes_per_episode=_ratio(sum(r.bytes for r in good), len(good)),
        new_episodes=len(made),
        workers=workers,
        wall_s=wall_s,
        physics_s=physics_s,
        render_s=render_s,
        write_s=sum(r.write_s for r in now),
        control_steps_per_s=_ratio(sum(r.steps for r in now if r.physics_s), physics_s),
        camera_sets_per_s=_ratio(sum(r.steps for r in made), render_s),
        episodes_per_hour=_ratio(3600 * len(made), wall_s),
    )


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else 0.0
