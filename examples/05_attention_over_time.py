"""Record one demonstration, label it, and watch its attention move with the object.

Writes an ordinary run folder, so every verb goes on from here.

    python examples/05_attention_over_time.py --run runs/one
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tyro
from PIL import Image

from codediffuser.datagen.collect import CollectOptions, collect_demos
from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datagen.pictures import PictureOptions
from codediffuser.datagen.sampling_settings import SamplingSettings
from codediffuser.datagen.scene_files import sample_scenes
from codediffuser.datagen.scene_sampler import SceneSource
from codediffuser.datagen.task import get_task
from codediffuser.labeling.attention import AttentionField
from codediffuser.labeling.attention_2d import attention_mask
from codediffuser.labeling.auto import label_episode, start_cloud


def main(run: Path, task: str = "pack_battery", camera: str = "direct_up") -> None:
    """Print where the attended points are at four moments; save a masked picture of each."""
    chosen = get_task(task)
    for _ in sample_scenes(SceneSource(chosen, SamplingSettings(root_seed=0)), run / "scenes", 1):
        pass
    options = CollectOptions(pictures=PictureOptions(width=160, height=120))
    for result in collect_demos(run, options):
        print("recorded:", result.scene_id, result.reason or "success")

    episode = Episode.open(list_episodes(run)[0])
    labels = label_episode(episode.folder)
    poses = episode.trajectory.T_world_object
    field = AttentionField(labels.labels, {name: poses(name, 0) for name in movable(episode)})
    on_cloud = field.at(start_cloud(episode, chosen), {n: poses(n, 0) for n in movable(episode)})
    print("attended points of the fused cloud at frame 0:", on_cloud.sum(axis=0).astype(int))

    for frame in np.linspace(0, episode.num_frames - 1, 4).astype(int):
        points_world, attention = field.carried({n: poses(n, frame) for n in movable(episode)})
        pick = points_world[attention[:, 0] > 0]
        seen = episode.frame(int(frame))
        mask = attention_mask(points_world, episode.cameras[camera], seen.depth_m[camera])
        out = run / f"attention_{frame:03d}.png"
        Image.fromarray(np.where(mask[..., None], seen.rgb[camera], 40).astype(np.uint8)).save(out)
        print(f"frame {frame}: object at {np.round(pick.mean(axis=0), 3)} m, {out}")


def movable(episode: Episode) -> tuple[str, ...]:
    """Ids of the objects that can move."""
    return episode.trajectory.object_ids


if __name__ == "__main__":
    tyro.cli(main)
