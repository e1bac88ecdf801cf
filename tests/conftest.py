"""Builders with defaults, so that a test states only what differs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

from codediffuser.datagen.scene import (
    Ambiguity,
    InstructionSpec,
    ObjectSpec,
    PlaceSpec,
    SceneSpec,
    SeedKey,
    Target,
)
from codediffuser.datagen.trajectory import Trajectory

# A busy machine is no failure of the law under test.
settings.register_profile("shared_machine", deadline=None, max_examples=50)
settings.load_profile("shared_machine")


@pytest.fixture
def small_scene() -> SceneSpec:
    """One waiting battery, two free slots; not drawn by the sampler."""
    return SceneSpec(
        task="pack_battery",
        scene_id="000042",
        seed=SeedKey(root=0, stage="SCENE", index=42, attempt=0),
        objects=(
            ObjectSpec(
                id="crate", category="crate", name="crate", position_m=(-0.01, 0.18, 0.0),
                color_rgb=(0.4, 0.4, 0.4), fixed=True,
            ),
            ObjectSpec(
                id="battery_0", category="battery", name="green battery",
                position_m=(0.0, 0.0, 0.0), color_rgb=(0.2, 0.5, 0.2),
            ),
        ),
        places=tuple(
            PlaceSpec(
                id=f"slot_{i}", category="slot", position_m=(0.02 - 0.042 * i, 0.18, 0.005),
                size_m=(0.042, 0.042, 0.05), center_m=(0.02 - 0.042 * i, 0.18, 0.03),
            )
            for i in range(2)
        ),
        target=Target(pick="battery_0", place="slot_0"),
        ambiguity=Ambiguity(picks=1, places=2),
        instruction=InstructionSpec(
            text="Put the battery in the right slot.", kind="no_slackness",
            template_id="pack_battery/no_slackness/0", components={},
            pairs=(("battery_0", "slot_0"),),
        ),
    )  # fmt: skip


@pytest.fixture
def make_trajectory() -> Callable[..., Trajectory]:
    """Random but lawful motion: unit quaternions, valid rotation-6D."""

    def make(num_steps: int = 4, seed: int = 0) -> Trajectory:
        from codediffuser.poses import matrix_to_rot6d, quat_wxyz_to_matrix

        rng = np.random.default_rng(seed)
        moments = num_steps + 1

        def quats(*shape: int) -> np.ndarray:
            q = rng.normal(size=(*shape, 4))
            return q / np.linalg.norm(q, axis=-1, keepdims=True)

        actions = np.column_stack([
            rng.uniform(-0.3, 0.3, (num_steps, 3)),
            matrix_to_rot6d(quat_wxyz_to_matrix(quats(num_steps))),
            rng.uniform(0, 0.04, num_steps),
        ])  # fmt: skip
        return Trajectory(
            object_ids=("battery_0",),
            object_position_m=rng.normal(size=(moments, 1, 3)),
            object_quat_wxyz=quats(moments, 1),
            object_velocity=np.zeros((moments, 1, 6)),
            qpos=rng.uniform(0, 0.04, (moments, 9)),
            qvel=rng.normal(size=(moments, 9)),
            hand_position_m=rng.normal(size=(moments, 3)),
            hand_quat_wxyz=quats(moments),
            actions=actions.astype(np.float32),
        )

    return make


@pytest.fixture
def write_synthetic_episode(
    small_scene: SceneSpec, make_trajectory: Callable[..., Trajectory]
) -> Callable[..., tuple[Path, Trajectory, list[Any]]]:
    """Write an episode with two small cameras and made-up pictures; no simulator.

    The function returns the folder, its trajectory and the pictures of each step.
    """

    def write(
        run: Path, episode_id: str = "000042", num_steps: int = 4, **options: Any
    ) -> tuple[Path, Trajectory, list[Any]]:
        from codediffuser.datagen.episode_format import Camera, ConditionRecord
        from codediffuser.datagen.episode_writer import EpisodeFacts, write_episode
        from codediffuser.datagen.log_step import Pictures, trajectory_steps
        from codediffuser.poses import pose_to_transform

        rng = np.random.default_rng(int(episode_id))
        height, width = 24, 32
        K = np.array([[30.0, 0, 15.5], [0, 30.0, 11.5], [0, 0, 1]])
        cameras = {
            name: Camera(
                K, pose_to_transform(rng.normal(size=3), rng.normal(size=4)), width, height
            )
            for name in ("left", "right")
        }
        smooth = np.linspace(0, 255, width)[None, :, None] * np.ones((height, 1, 3))
        pictures = [
            Pictures(
                rgb={n: np.roll(smooth, k, 1).astype(np.uint8) for n in cameras},
                depth_mm={
                    n: rng.integers(0, 2000, (height, width)).astype(np.uint16) for n in cameras
                },
            )
            for k in range(num_steps)
        ]
        scene = small_scene.model_copy(update={"scene_id": episode_id})
        scene_file = run / "scenes" / f"{episode_id}.yaml"
        scene.save(scene_file)
        trajectory = make_trajectory(num_steps, seed=int(episode_id))
        folder = run / "episodes" / episode_id
        write_episode(
            folder,
            EpisodeFacts(
                id=episode_id,
                task=scene.task,
                source="simulation",
                instruction=scene.instruction.text,
                success=True,
                seed=scene.seed,
                conditions=(
                    ConditionRecord(name="upright", value=1.0, threshold=0.99, holds=True),
                ),
            ),
            cameras,
            trajectory_steps(trajectory, pictures),
            scene_file=scene_file,
            trajectory=trajectory,
            **options,
        )
        return folder, trajectory, pictures

    return write


@pytest.fixture(scope="session")
def battery_pictures() -> Callable[..., tuple[dict[str, Any], list[Any]]]:
    """Draw a trajectory of a `pack_battery` scene by projecting samples of its surfaces.

    The function returns the task's cameras at a small size and one set of pictures per step. No
    simulator, no robot: what the cameras see is the crate and the batteries.
    """
    import trimesh

    from codediffuser.datagen.cameras import camera_parameters, project
    from codediffuser.datagen.episode_format import Camera
    from codediffuser.datagen.log_step import Pictures
    from codediffuser.datagen.task import get_task
    from codediffuser.poses import apply_transform

    task = get_task("pack_battery")
    width, height = 80, 60
    config = task.config.cameras.model_copy(update={"width": width, "height": height})
    cameras = {n: Camera(K, T, width, height) for n, (K, T) in camera_parameters(config).items()}
    surfaces: dict[str, np.ndarray] = {}

    def surface(obj: ObjectSpec) -> np.ndarray:
        if obj.category not in surfaces:
            mesh = task.geometry(obj).visual
            count = int(mesh.area / 0.0025**2)
            points, _ = trimesh.sample.sample_surface(mesh, count, seed=0)
            surfaces[obj.category] = np.asarray(points, dtype=np.float32)
        return surfaces[obj.category]

    def depth_mm(points: np.ndarray, camera: Camera) -> np.ndarray:
        uv, depth_m = project(points, camera.K, camera.T_world_camera)
        column, row = np.round(uv).astype(int).T
        seen = (depth_m > 0.05) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        nearest = np.full(width * height, np.inf)
        np.minimum.at(nearest, (row * width + column)[seen], depth_m[seen])
        nearest[np.isinf(nearest)] = 0.0
        return np.round(nearest * 1000).reshape(height, width).astype(np.uint16)

    def draw(scene: SceneSpec, trajectory: Trajectory) -> tuple[dict[str, Any], list[Any]]:
        pictures = []
        gray = {name: np.full((height, width, 3), 90, np.uint8) for name in cameras}
        for k in range(trajectory.num_steps):
            world = np.concatenate([
                apply_transform(
                    o.T_world_object if o.fixed else trajectory.T_world_object(o.id, k), surface(o)
                )
                for o in scene.objects
            ])  # fmt: skip
            pictures.append(
                Pictures(rgb=gray, depth_mm={n: depth_mm(world, c) for n, c in cameras.items()})
            )
        return cameras, pictures

    return draw


@pytest.fixture
def make_carry(small_scene: SceneSpec) -> Callable[..., Trajectory]:
    """The hand carries `battery_0` of `small_scene` in an arc to `slot_0`; no physics."""

    def make(num_steps: int = 6) -> Trajectory:
        from codediffuser.poses import matrix_to_quat_wxyz, matrix_to_rot6d

        along = np.linspace(0, 1, num_steps + 1)
        start = np.array(small_scene.object("battery_0").position_m)
        stop = np.array(small_scene.place("slot_0").position_m)
        battery = start + along[:, None] * (stop - start)
        battery[:, 2] += 0.12 * np.sin(np.pi * along)
        hand = battery + np.array([0.0, 0.0, 0.13])
        R_down = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
        opening = np.full(num_steps + 1, 0.015)
        return Trajectory(
            object_ids=("battery_0",),
            object_position_m=battery[:, None],
            object_quat_wxyz=np.tile([1.0, 0, 0, 0], (num_steps + 1, 1, 1)),
            object_velocity=np.zeros((num_steps + 1, 1, 6)),
            qpos=np.column_stack([np.zeros((num_steps + 1, 7)), opening, opening]),
            qvel=np.zeros((num_steps + 1, 9)),
            hand_position_m=hand,
            hand_quat_wxyz=np.tile(matrix_to_quat_wxyz(R_down), (num_steps + 1, 1)),
            actions=np.column_stack(
                [hand[1:], np.tile(matrix_to_rot6d(R_down), (num_steps, 1)), opening[1:]]
            ).astype(np.float32),
        )

    return make


@pytest.fixture
def write_battery_episode(
    small_scene: SceneSpec,
    make_carry: Callable[..., Trajectory],
    battery_pictures: Callable[..., tuple[dict[str, Any], list[Any]]],
) -> Callable[..., Path]:
    """Write an episode of `small_scene` whose pictures show what moves; returns its folder."""

    def write(
        run: Path,
        episode_id: str = "000042",
        num_steps: int = 6,
        *,
        success: bool = True,
        text: str = "Put the battery in the right slot.",
    ) -> Path:
        from codediffuser.datagen.episode_writer import EpisodeFacts, write_episode
        from codediffuser.datagen.log_step import trajectory_steps

        seed = small_scene.seed.model_copy(update={"index": int(episode_id)})
        words = small_scene.instruction.model_copy(update={"text": text})
        scene = small_scene.model_copy(
            update={"scene_id": episode_id, "seed": seed, "instruction": words}
        )
        scene_file = run / "scenes" / f"{episode_id}.yaml"
        scene.save(scene_file)
        trajectory = make_carry(num_steps)
        cameras, pictures = battery_pictures(scene, trajectory)
        folder = run / "episodes" / episode_id
        write_episode(
            folder,
            EpisodeFacts(
                id=episode_id, task=scene.task, source="simulation", instruction=text,
                success=success, seed=seed, reason="" if success else "upright",
            ),
            cameras,
            trajectory_steps(trajectory, pictures),
            scene_file=scene_file,
            trajectory=trajectory,
        )  # fmt: skip
        return folder

    return write
