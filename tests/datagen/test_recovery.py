"""Recovery demonstrations: pushed, made good, and told exactly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from codediffuser.datagen.motion import command_of, interpolate
from codediffuser.datagen.recovery import (
    OFFSET_M,
    RECOVER,
    Push,
    draw_push,
    recovery_record,
)
from codediffuser.datagen.scene import SceneSpec, SeedKey
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import TASKS, Move, get_task
from codediffuser.datagen.tasks.pack_battery import PackBattery
from codediffuser.errors import ConfigError
from codediffuser.poses import rot6d_to_matrix

if TYPE_CHECKING:
    from codediffuser.datagen.envs import SceneEnv
    from codediffuser.datagen.script import ExpertRun


def seed(index: int) -> SeedKey:
    return SeedKey(root=0, stage="SCENE", index=index, attempt=0)


def a_push(**changes: object) -> Push:
    values: dict[str, object] = {
        "phase": "transport", "at": 0.5, "steps": 6, "offset_m": (0.04, -0.02, 0.01),
        "rotation_rad": (0.0, 0.0, 0.2), "recover_steps": 10,
    }  # fmt: skip
    return Push.model_validate({**values, **changes})


@pytest.mark.parametrize(("probability", "expected"), [(0.0, 0), (0.3, 60), (1.0, 200)])
def test_as_many_are_pushed_as_asked(
    pack_battery: PackBattery, probability: float, expected: int
) -> None:
    drawn = [draw_push(pack_battery, seed(i), probability) for i in range(200)]
    assert sum(p is not None for p in drawn) == pytest.approx(expected, abs=25)


def test_who_is_pushed_at_a_low_share_is_also_pushed_at_a_high_one(
    pack_battery: PackBattery,
) -> None:
    for index in range(50):
        rare = draw_push(pack_battery, seed(index), 0.2)
        assert rare is None or rare == draw_push(pack_battery, seed(index), 0.8)


def test_pushes_have_their_length_and_never_go_down(pack_battery: PackBattery) -> None:
    for index in range(100):
        push = draw_push(pack_battery, seed(index), 1.0)
        assert push is not None and push.phase in pack_battery.push_phases
        assert OFFSET_M[0] <= np.linalg.norm(push.offset_m) <= OFFSET_M[1]
        assert push.offset_m[2] >= 0


def test_a_share_above_one_is_refused(pack_battery: PackBattery) -> None:
    with pytest.raises(ConfigError, match=r"a probability from 0 to 1, got 1\.5"):
        draw_push(pack_battery, seed(0), 1.5)


def test_a_push_grows_evenly_to_its_offset(expert_run: ExpertRun) -> None:
    push = a_push()
    planned = expert_run.trajectory.actions[40:46]
    led = push.displace(planned)
    moved = (led - planned)[:, :3]
    np.testing.assert_allclose(moved[-1], push.offset_m, atol=1e-6)
    np.testing.assert_allclose(moved[2], np.array(push.offset_m) / 2, atol=1e-6)
    turn = rot6d_to_matrix(led[-1, 3:9]) @ rot6d_to_matrix(planned[-1, 3:9]).T
    assert np.arctan2(turn[1, 0], turn[0, 0]) == pytest.approx(0.2, abs=1e-4)
    np.testing.assert_array_equal(led[:, 9], planned[:, 9])


def test_a_push_fits_only_moves_of_its_phase_that_are_long_enough() -> None:
    pose = np.eye(4)
    assert a_push().fits(Move("transport", pose, 30, 0.0))
    assert not a_push().fits(Move("transport", pose, 6, 0.0))
    assert not a_push().fits(Move("lower", pose, 30, 0.0))
    for at, start in ((0.0, 0), (1.0, 24)):
        assert a_push(at=at).start(Move("transport", pose, 30, 0.0)) == start


def test_a_command_is_what_its_action_says(expert_run: ExpertRun) -> None:
    action = expert_run.trajectory.actions[60]
    command = command_of(action)
    still = interpolate(command, Move("hold", _pose(action), 3, float(action[9])))
    np.testing.assert_allclose(still[-1], action, atol=1e-6)


@pytest.fixture(scope="module")
def pushed(physics: SceneEnv, scenes: list[SceneSpec]) -> ExpertRun:
    from codediffuser.datagen.script import run_expert

    return run_expert(physics, scenes[0], np.random.default_rng(0), a_push())


def test_the_expert_makes_a_push_good(pushed: ExpertRun, expert_run: ExpertRun) -> None:
    assert pushed.success
    assert RECOVER in pushed.phases and RECOVER not in expert_run.phases
    assert pushed.pushed_at is not None
    before, after = pushed.pushed_at, pushed.pushed_at + 6
    same = slice(0, before + 1)
    np.testing.assert_array_equal(
        pushed.trajectory.hand_position_m[same], expert_run.trajectory.hand_position_m[same]
    )
    off = pushed.trajectory.hand_position_m[after] - expert_run.trajectory.hand_position_m[after]
    assert np.linalg.norm(off) > 0.01


def test_recorded_actions_never_follow_the_push(pushed: ExpertRun, expert_run: ExpertRun) -> None:
    assert pushed.pushed_at is not None
    until = pushed.pushed_at + 6
    np.testing.assert_array_equal(
        pushed.trajectory.actions[:until], expert_run.trajectory.actions[:until]
    )


def test_actions_and_the_stored_push_give_the_states_again(
    physics: SceneEnv, pushed: ExpertRun
) -> None:
    assert pushed.pushed_at is not None
    record = recovery_record(seed(0), 1.0, a_push(), pushed.pushed_at)
    physics.reset(options={"scene": pushed.scene})
    for action in record.executed(pushed.trajectory.actions):
        physics.control_step(action)
    np.testing.assert_array_equal(physics.view.moment().qpos, pushed.trajectory.qpos[-1])


@pytest.mark.parametrize(
    ("task", "phase"), [(t, p) for t in TASKS.names() for p in get_task(t).push_phases]
)
def test_every_task_makes_pushes_good_in_all_its_phases(task: str, phase: str) -> None:
    from codediffuser.datagen.envs import physics_env
    from codediffuser.datagen.script import run_expert

    scene = sample_scene(get_task(task), root_seed=0, index=0)
    run = run_expert(physics_env(task, scene), scene, np.random.default_rng(0), a_push(phase=phase))
    assert run.pushed_at is not None and run.phases[run.pushed_at] == phase
    assert run.success, run.failure_reason


def _pose(action: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rot6d_to_matrix(action[3:9]), action[:3]
    return T
