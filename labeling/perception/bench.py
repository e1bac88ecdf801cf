"""Measures the cloud pipeline: `python -m codediffuser.labeling.perception.bench RUN`.

For frames of a real episode: all cameras' depth to one cloud of the workspace, thinned to 8000
points, clustered. The same chain is written with Open3D alone, in the fastest form that Open3D
has, and both take turns frame by frame in one process, so that a busy machine slows both. Reading
the episode is not measured; removing flying pixels, which Open3D has no word for, is.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import tyro

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datagen.task import get_task
from codediffuser.datagen.task_config import ClusterConfig, Workspace
from codediffuser.errors import BelowTargetError, EpisodeError
from codediffuser.labeling.perception.cloud import EVEN_POINTS, CloudFuser
from codediffuser.labeling.perception.clustering import cluster_points
from codediffuser.labeling.perception.views import View, views_at

MAX_DEPTH_M = 2.0
MIN_RATIO = 5.0
STAGES = ("fuse and crop", "sample", "cluster")


@dataclasses.dataclass(frozen=True, slots=True)
class Chain:
    """One frame through one chain."""

    seconds: tuple[float, ...]
    """By `STAGES`."""
    points: int
    """Points in the workspace."""
    even: np.ndarray
    """(8000, 3) float, metres: what was clustered."""
    clusters: int
    """Clusters of at least `ClusterConfig.min_points` points."""


@dataclasses.dataclass(frozen=True, slots=True)
class CloudBench:
    """What a run measured, frame by frame."""

    size: tuple[int, int, int]
    """Views, height, width."""
    ours: tuple[Chain, ...]
    open3d: tuple[Chain, ...]

    @property
    def ratio(self) -> float:
        """How many times faster a whole frame is: the median over the frames."""
        pairs = zip(self.ours, self.open3d, strict=True)
        return float(np.median([sum(b.seconds) / sum(a.seconds) for a, b in pairs]))


def bench(run: tyro.conf.Positional[Path], *, frames: int = 20) -> CloudBench:
    """Measure both chains on frames spread over the first episode of a run.

    Args:
        run: Run with rendered episodes.
        frames: How many frames; another one goes first to warm up.

    Raises:
        EpisodeError: The run has no episodes.
    """
    folders = list_episodes(run)
    if not folders:
        raise EpisodeError(f"{run}: no episodes to measure with; run demo first")
    episode = Episode.open(folders[0])
    task = get_task(episode.manifest.task)
    workspace, config = task.config.workspace, task.config.labeling.clusters[task.pick_category]
    fuser = CloudFuser(workspace.low_m, workspace.high_m, max_depth_m=MAX_DEPTH_M)
    chains: list[Callable[[Sequence[View]], Chain]] = [
        partial(our_chain, fuser=fuser, config=config),
        partial(open3d_chain, workspace=workspace, config=config),
    ]
    rows: list[tuple[Chain, ...]] = []
    for number, frame in enumerate(np.linspace(0, episode.num_frames - 1, frames + 1).astype(int)):
        views = views_at(episode, int(frame))
        turn = number % 2  # who goes first changes
        row = {k: chains[k](views) for k in (turn, 1 - turn)}
        rows.append((row[0], row[1]))
    ours, open3d = zip(*rows[1:], strict=True)
    return CloudBench((len(views), *views[0].depth_m.shape), ours, open3d)


def our_chain(views: Sequence[View], *, fuser: CloudFuser, config: ClusterConfig) -> Chain:
    """One frame through `CloudFuser` and `cluster_points`."""
    clock = [time.perf_counter()]
    cloud = fuser.fuse(views)
    clock.append(time.perf_counter())
    even = fuser.even(cloud)
    clock.append(time.perf_counter())
    found = cluster_points(even.points_world, config.model_copy(update={"min_share": 0.0}))
    clock.append(time.perf_counter())
    return Chain(_steps(clock), len(cloud), even.points_world, int(found.max(initial=-1)) + 1)


def open3d_chain(views: Sequence[View], *, workspace: Workspace, config: ClusterConfig) -> Chain:
    """One frame through Open3D's legacy API, whose sampling is 80 times faster than the tensor one.

    Everything that can be made once for all frames, intrinsics and box, is made before the clock.
    """
    import open3d as o3d

    box = o3d.geometry.AxisAlignedBoundingBox(workspace.low_m, workspace.high_m)
    cameras = [
        (
            o3d.camera.PinholeCameraIntrinsic(v.camera.width, v.camera.height, v.camera.K),
            np.linalg.inv(v.camera.T_world_camera),
        )
        for v in views
    ]
    clock = [time.perf_counter()]
    cloud = o3d.geometry.PointCloud()
    for view, (intrinsic, extrinsic) in zip(views, cameras, strict=True):
        image = o3d.geometry.Image(view.depth_m)  # type: ignore[call-overload]
        cloud += o3d.geometry.PointCloud.create_from_depth_image(
            image, intrinsic, extrinsic, depth_scale=1.0, depth_trunc=MAX_DEPTH_M
        )
    cloud = cloud.crop(box)
    clock.append(time.perf_counter())
    even = cloud.farthest_point_down_sample(min(EVEN_POINTS, len(cloud.points)))
    clock.append(time.perf_counter())
    found = np.asarray(even.cluster_dbscan(config.eps_m, config.min_neighbours))
    clock.append(time.perf_counter())
    sizes = np.bincount(found[found >= 0])
    clusters = int(np.sum(sizes >= config.min_points))
    return Chain(_steps(clock), len(cloud.points), np.asarray(even.points), clusters)


def _steps(clock: Sequence[float]) -> tuple[float, ...]:
    return tuple(float(s) for s in np.diff(clock))


def report(result: CloudBench) -> str:
    """The figures as text."""
    views, height, width = result.size
    lines = [f"{len(result.ours)} frames, {views} views of {width}x{height}; medians in ms"]
    lines.append(f"{'':10}{''.join(f'{s:>16}' for s in (*STAGES, 'frame'))}")
    for name in ("ours", "open3d"):
        chains: tuple[Chain, ...] = getattr(result, name)
        ms = 1e3 * np.array([[*c.seconds, sum(c.seconds)] for c in chains])
        lines.append(f"{name:10}{''.join(f'{m:16.1f}' for m in np.median(ms, axis=0))}")
        lines.append(
            f"{'':10}{chains[-1].points} points in the workspace, {len(chains[-1].even)} even, "
            f"{chains[-1].clusters} clusters in the last frame"
        )
    lines.append(f"a whole frame is {result.ratio:.1f} times faster (target {MIN_RATIO:.0f})")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the figures; exit with 3 when the target is missed."""
    result = tyro.cli(bench)
    sys.stdout.write(report(result))
    if result.ratio < MIN_RATIO:
        sys.exit(BelowTargetError.exit_code)


if __name__ == "__main__":
    main()
