"""ManiSkill trajectories of simulated episodes: `trajectory.h5` and `trajectory.json`.

Layout: mani_skill/utils/wrappers/record.py. States, rewards and joint positions have a last row
after the last action; pictures have none there, since none was taken. Each episode's scene stands
in `reset_kwargs`, so ManiSkill's `replay_trajectory` sets up the very scene, given that
`codediffuser.datagen.envs` was imported.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from codediffuser.datagen import trajectory
from codediffuser.datagen.episode import Episode
from codediffuser.datagen.episode_format import Camera, EpisodeManifest
from codediffuser.datagen.task import get_task
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.datasets import clouds, episode_clouds
from codediffuser.datasets.exporting import h5_parts, pictures, source
from codediffuser.datasets.exporting.format import FORMATS, ExportFormat, same_for_all
from codediffuser.datasets.exporting.h5_parts import (
    PicturePaths,
    copy_group,
    make_groups,
    open_part,
    put,
    write_cloud,
    write_pictures,
)
from codediffuser.datasets.exporting.part import Part
from codediffuser.datasets.exporting.source import Source, labels_json
from codediffuser.errors import DatasetError
from codediffuser.files import write_json
from codediffuser.labeling import attention, attention_2d, motion
from codediffuser.poses import invert_transform

NAME = "trajectory"
PATHS = PicturePaths(
    rgb="obs/sensor_data/{camera}/rgb",
    depth="obs/sensor_data/{camera}/depth",
    mask="obs/sensor_data/{camera}/attention",
    channel_axis=True,
)
HALF_PIXEL = 0.5
"""ManiSkill counts pixels from the outer corner of the first, we from its centre."""
GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])


@FORMATS.add("maniskill")
@dataclass(frozen=True)
class ManiSkillFormat(ExportFormat):
    """One trajectory file that ManiSkill loads and replays."""

    NAME = "maniskill"
    PROFILES = ("portable", "pointcloud", "masked-rgb")

    def modules(self) -> tuple[ModuleType, ...]:
        """The code that decides the bytes of a part."""
        shared = (h5_parts, pictures, source, clouds, episode_clouds, trajectory)
        return (*shared, attention, attention_2d, motion)

    def make(self, source: Source, folder: Path) -> None:
        """Write one trajectory."""
        episode = source.episode
        recorded = _simulated(episode)
        length = recorded.num_steps
        succeeds = np.arange(length) == length - 1
        with open_part(folder, "w") as file:
            file["actions"] = recorded.actions
            file["terminated"] = np.zeros(length, dtype=bool)
            file["truncated"] = succeeds
            file["success"] = succeeds & source.manifest.success
            _write_states(file, recorded, source.manifest.task)
            put(file, "obs/agent/qpos", recorded.qpos.astype(np.float32))
            put(file, "obs/agent/qvel", recorded.qvel.astype(np.float32))
            if self.options.profile == "pointcloud":
                write_cloud(file, "obs/pointcloud", source, self.options.cloud)
            else:
                write_pictures(file, source, self.options, PATHS, self.labelled)
                for name in file["obs/sensor_data"]:
                    _write_camera(file, name, source.camera_at(name, 0), length)
            file.attrs["episode_id"] = episode.id
            file.attrs["instruction"] = source.manifest.instruction
            file.attrs["scene"] = json.dumps(episode.scene.model_dump(mode="json", by_alias=True))
            if self.labelled:
                file.attrs["labels"] = labels_json(source.folder)

    def assemble(
        self, root: Path, parts: Sequence[Part], manifests: Sequence[EpisodeManifest]
    ) -> None:
        """Copy the trajectories into one file and write the JSON beside it."""
        import h5py

        task = same_for_all(manifests, "task", [m.task for m in manifests])
        episodes = []
        with h5py.File(root / f"{NAME}.h5", "w", track_order=True) as file:
            for i, part in enumerate(parts):
                with open_part(part.folder) as made:
                    copy_group(made, file.create_group(f"traj_{i}", track_order=True))
                    scene = json.loads(made.attrs["scene"])
                episodes.append(_episode_entry(i, manifests[i], scene))
        write_json(
            root / f"{NAME}.json",
            {
                "env_info": _env_info(task, manifests[0]),
                "source_type": "motionplanning",
                "source_desc": "scripted expert of codediffuser",
                "episodes": episodes,
            },
        )

    def recover(self, previous: Path, index: int, folder: Path) -> bool:
        """Copy one trajectory out of an earlier file."""
        import h5py

        with h5py.File(previous / f"{NAME}.h5", "r") as file, open_part(folder, "w") as part:
            copy_group(file[f"traj_{index}"], part)
        return True


def _simulated(episode: Episode) -> Trajectory:
    if episode.manifest.source != "simulation":
        raise DatasetError(
            "a real recording has no simulator states; export it --to lerobot, zarr, robomimic "
            "or aloha"
        )
    return episode.trajectory


def _write_states(file: Any, recorded: Trajectory, task: str) -> None:
    """Simulator states at T + 1 moments: position, quaternion, velocities; then the joints."""
    from codediffuser.datagen.robot import ROBOT_UID, base_pose

    objects = np.concatenate(
        [recorded.object_position_m, recorded.object_quat_wxyz, recorded.object_velocity], axis=-1
    ).astype(np.float32)
    for i, name in enumerate(recorded.object_ids):
        put(file, f"env_states/actors/{name}", objects[:, i])
    base = base_pose(get_task(task).config.robot)
    moments = len(recorded.qpos)
    root = np.concatenate([base.p, base.q, np.zeros(6)])
    robot = np.concatenate([np.tile(root, (moments, 1)), recorded.qpos, recorded.qvel], axis=1)
    put(file, f"env_states/articulations/{ROBOT_UID}", robot.astype(np.float32))


def _write_camera(file: Any, name: str, camera: Camera, length: int) -> None:
    K = camera.K.copy()
    K[:2, 2] += HALF_PIXEL
    T_camera_world = invert_transform(camera.T_world_camera)
    for key, value in (
        ("intrinsic_cv", K),
        ("extrinsic_cv", T_camera_world[:3]),
        ("cam2world_gl", camera.T_world_camera @ GL_FROM_CV),
    ):
        repeated = np.tile(value, (length, 1, 1)).astype(np.float32)
        path = f"obs/sensor_param/{name}/{key}"
        make_groups(file, path)
        file.create_dataset(path, data=repeated, compression="gzip")


def _episode_entry(index: int, manifest: EpisodeManifest, scene: dict[str, Any]) -> dict[str, Any]:
    # The simulator is loaded only where it is needed.
    from codediffuser.datagen.robot import CONTROL_MODE

    seed = manifest.seed.index if manifest.seed is not None else index
    return {
        "episode_id": index,
        "episode_seed": seed,
        "control_mode": CONTROL_MODE,
        "elapsed_steps": manifest.frames,
        "success": manifest.success,
        "reset_kwargs": {"seed": seed, "options": {"scene": scene}},
    }


def _env_info(task: str, manifest: EpisodeManifest) -> dict[str, Any]:
    from codediffuser.datagen.envs import env_id
    from codediffuser.datagen.robot import CONTROL_MODE

    return {
        "env_id": env_id(task),
        "max_episode_steps": get_task(task).config.max_steps,
        "env_kwargs": {
            "obs_mode": "none",
            "control_mode": CONTROL_MODE,
            "sim_backend": "physx_cpu",
            "render_backend": "none",
            "sim_config": {"control_freq": manifest.hz},
        },
    }
