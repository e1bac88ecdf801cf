"""Records a run on a two-node Ray cluster of this machine while a worker and a node are killed.

Shows that nothing is lost, nothing made twice, and every episode is the one that a single process
records: `python -m codediffuser.datagen.executors.ray_drill`.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from codediffuser.datagen.collect import CollectOptions, collect_demos
from codediffuser.datagen.episode import list_episodes, load_manifest
from codediffuser.datagen.pictures import PictureOptions
from codediffuser.datagen.scene import scene_path
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.shards.drive import collect_shards
from codediffuser.datagen.shards.lease import LEASES, Lease
from codediffuser.datagen.shards.plan import SHARDS
from codediffuser.datagen.task import get_task
from codediffuser.errors import BelowTargetError
from codediffuser.files import TEMPORARY_PREFIX

NODE: dict[str, Any] = {
    "num_cpus": 1,
    "object_store_memory": 80_000_000,
    "node_ip_address": "127.0.0.2",
}
"""Bound to the machine itself, by an address that `ray.init` does not take for a name of the
machine's own: 127.0.0.1 it replaces by one at which nothing listens."""


@dataclass(frozen=True, slots=True)
class DrillResult:
    """What came of the drill."""

    scenes: int
    recorded: int
    """Scenes that were reported, each counted once."""
    twice: int
    """Scenes that were reported more than once."""
    equal: int
    """Episodes whose log has the hash that one process on its own gives."""
    leftovers: int
    """Half-written files and folders at the end."""
    wall_s: float

    @property
    def passed(self) -> bool:
        """Whether nothing was lost, doubled, changed or left."""
        whole = self.recorded == self.equal == self.scenes
        return whole and self.twice == 0 and self.leftovers == 0


def drill(
    task: str = "pack_battery", *, scenes: int = 6, width: int = 64, height: int = 48
) -> Iterator[str | DrillResult]:
    """Record the same scenes alone and on the cluster; yield what happens, the result last.

    Args:
        task: Registered task.
        scenes: How many, each a shard of its own; at least 4, so that both kills hit work.
        width: Of the pictures of the task's first camera, pixels.
        height: The same.
    """
    options = CollectOptions(pictures=_one_camera(task, width, height))
    with tempfile.TemporaryDirectory(prefix="codediffuser-drill-") as folder:
        alone, shared = Path(folder) / "alone", Path(folder) / "shared"
        for index in range(scenes):
            scene = sample_scene(get_task(task), root_seed=11, index=index)
            for run in (alone, shared):
                scene.save(scene_path(run, scene.scene_id))
        yield f"{scenes} scenes by one process"
        list(collect_demos(alone, options))
        began = time.monotonic()
        seen: Counter[str] = Counter()
        for news in _sabotaged(shared, options):
            if isinstance(news, str):
                yield news
            else:
                seen.update(news)
        expected, found = _contents(alone), _contents(shared)
        yield DrillResult(
            scenes=scenes,
            recorded=len(seen),
            twice=sum(count > 1 for count in seen.values()),
            equal=sum(found.get(name) == digest for name, digest in expected.items()),
            leftovers=len(list(shared.rglob(f"{TEMPORARY_PREFIX}*"))),
            wall_s=time.monotonic() - began,
        )


def _sabotaged(run: Path, options: CollectOptions) -> Iterator[str | list[str]]:
    """Record a run on two nodes; kill a worker after the first episode, a node after the second."""
    # Ray gives a node 30 s to start, which a busy machine exceeds. It reads this when imported.
    os.environ.setdefault("RAY_raylet_start_wait_time_s", "300")
    import ray
    from ray.cluster_utils import Cluster

    from codediffuser.datagen.executors.ray import RayExecutor

    cluster = Cluster(initialize_head=True, head_node_args={**NODE, "include_dashboard": False})
    doomed = cluster.add_node(**NODE)
    ray.init(address=cluster.address, log_to_driver=False, logging_level=logging.ERROR)
    yield f"Ray {ray.__version__} with {len(ray.nodes())} nodes"
    try:
        results = collect_shards(run, RayExecutor(workers=2), options, shard_size=1, lease_s=20)
        for number, result in enumerate(results, start=1):
            yield f"{result.scene_id} recorded"
            yield [result.scene_id]
            if number == 1:
                yield _kill_worker(run)
            if number == 2:
                cluster.remove_node(doomed, allow_graceful=False)
                yield "killed a node"
    finally:
        ray.shutdown()
        cluster.shutdown()


def _kill_worker(run: Path) -> str:
    """Kill the process of one actor that is in the middle of a shard."""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        for path in sorted((run / SHARDS / LEASES).glob("0*.json")):
            lease = Lease.load(path)
            os.kill(lease.pid, signal.SIGKILL)
            return f"killed the worker of shard {lease.shard}"
        time.sleep(0.1)
    return "no worker was busy"


def _contents(run: Path) -> dict[str, str]:
    return {path.name: load_manifest(path).content_hash for path in list_episodes(run)}


def _one_camera(task: str, width: int, height: int) -> PictureOptions:
    cameras: Any = get_task(task).config.cameras
    first = cameras.model_copy(
        update={"views": cameras.views[:1], "width": width, "height": height}
    )
    return PictureOptions(cameras=first)


def main() -> int:
    """Print the drill as it goes; 3 when something was lost, doubled or changed."""
    for news in tyro.cli(drill):
        sys.stdout.write(f"{news}\n")
        sys.stdout.flush()
    return 0 if isinstance(news, DrillResult) and news.passed else BelowTargetError.exit_code


if __name__ == "__main__":
    raise SystemExit(main())
