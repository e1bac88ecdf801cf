"""Facts about one rollout: what is judged, what is counted, what never crashes."""

import numpy as np
import pytest

from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import get_task
from codediffuser.eval.attention_source import Choice, OracleSource
from codediffuser.eval.film import film_cameras, motion_phases
from codediffuser.eval.rollout import ClosedLoop, RolloutOptions, success_holds
from codediffuser.seeding import Stage

pytestmark = pytest.mark.sim

STEPS = 200
"""The script takes 185."""


class Scripted:
    """A policy that plays given actions and looks at the first two steps of every forty."""

    def __init__(self):
        self.actions, self.step, self.seen = [], 0, []

    @property
    def needs_observation(self):
        return self.step % 40 < 2

    def reset(self, seed):
        self.step, self.seen, self.seed = 0, [], seed

    def act(self, points, state):
        assert (points is not None) == (state is not None) == self.needs_observation
        if points is not None:
            self.seen.append((points, state))
        action = self.actions[min(self.step, len(self.actions) - 1)]
        self.step += 1
        return np.asarray(action, dtype=np.float32)


class Fixed(OracleSource):
    """Chooses what it is told."""

    def __init__(self, answer):
        self.answer = answer

    def choose(self, task, scene):
        if isinstance(self.answer, Choice):
            return self.answer
        return Choice(self.answer, program="answer = told")


@pytest.fixture(scope="module")
def task():
    return get_task("pack_battery")


@pytest.fixture(scope="module")
def scene(task):
    return sample_scene(
        task, root_seed=3, index=0, stage=Stage.EVAL_SCENE, split="eval", picks=2, places=3
    )


@pytest.fixture(scope="module")
def loop(task):
    cameras = task.config.cameras.model_copy(update={"width": 160, "height": 120})
    return ClosedLoop(task, Scripted(), OracleSource(), RolloutOptions(STEPS), cameras=cameras)


@pytest.fixture(scope="module")
def expert_actions(loop, scene):
    from codediffuser.datagen.script import run_expert

    expert = run_expert(loop.env, scene, np.random.default_rng(0))
    assert expert.success
    return list(expert.trajectory.actions)


@pytest.fixture
def run(loop, scene):
    """Run with what a test changes, and leave the shared loop as it was."""
    source, options = loop.source, loop.options

    def go(actions, *, told=None, **changes):
        loop.policy.actions = actions
        loop.source = source if told is None else Fixed(told)
        loop.options = RolloutOptions(**({"max_steps": STEPS} | changes))
        return loop.run(scene)

    yield go
    loop.source, loop.options = source, options


@pytest.fixture
def home(loop, scene):
    """An action that holds the hand where it starts, fingers open."""
    return np.array([0, 0, 0.3, 0, 1, 0, 1, 0, 0, 0.04], dtype=np.float32)


def test_a_policy_that_does_it_right_succeeds(run, scene, expert_actions, loop):
    done = run(expert_actions)
    result = done.result
    assert result.success and result.ever_success and result.followed
    assert result.failure is None
    assert all(c.holds for c in result.final.conditions)
    assert result.final.pair == (scene.target.pick, scene.target.place)
    assert 100 < result.first_success_step < STEPS
    assert not done.holds[result.first_success_step - 1]
    assert (result.steps, result.observations, result.ik_failures) == (STEPS, 10, 0)
    assert result.attention.right
    assert motion_phases(done.trajectory)[0] == "reach"
    assert motion_phases(done.trajectory)[-1] == "released"


def test_the_policy_sees_the_cloud_and_state_of_the_moment(run, loop, expert_actions):
    done = run(expert_actions, max_steps=45)
    (cloud, state), (late, late_state) = loop.policy.seen[0], loop.policy.seen[-1]
    assert cloud.shape == (512, 5) and cloud.dtype == np.float32
    assert state == pytest.approx(
        [*done.trajectory.hand_position_m[0], *state[3:9], 0.04], abs=1e-3
    )
    assert (cloud[:, 3].sum(), cloud[:, 4].sum()) == (128, 128)
    # Attention follows the lifted battery: the attended points rise with it.
    assert late_state[2] < state[2]
    assert late[:, 3].sum() == 128


def test_a_rollout_is_the_same_each_time(run, expert_actions):
    first, second = (run(expert_actions, max_steps=60) for _ in range(2))
    assert np.array_equal(first.trajectory.qpos, second.trajectory.qpos)
    same = {"wall_s", "render_s", "policy_s"}
    assert first.result.model_dump(exclude=same) == second.result.model_dump(exclude=same)


def test_a_policy_that_does_nothing_misses(run, home):
    result = run([home], max_steps=10).result
    assert not result.success and not result.ever_success
    assert result.failure == "grasp:missed"
    assert result.first_success_step is None


def test_not_a_number_ends_the_rollout_as_a_failure(run, home):
    broken = home.copy()
    broken[4] = np.nan
    result = run([home, home, home, broken], max_steps=10).result
    assert result.failure == "policy:not_finite"
    assert result.detail.startswith("step 3: expected an action (10,) of finite numbers")
    assert result.steps == 3
    assert not result.success


def test_poses_out_of_reach_are_counted_and_survived(run, home):
    far = home.copy()
    far[:3] = (0.0, 1.4, 0.2)
    result = run([far], max_steps=5).result
    assert (result.ik_failures, result.steps) == (5, 5)


def test_doing_the_wrong_thing_well_is_no_success(run, scene, expert_actions):
    other = next(p.id for p in scene.free_places if p.id != scene.target.place)
    done = run(expert_actions, told=(scene.target.pick, other))
    assert done.result.success and not done.result.attention.right
    assert not done.result.followed
    assert done.field.labels[1].instance_id == other


def test_words_that_lead_nowhere_are_a_counted_failure(run, home):
    told = Choice(None, program="while True: pass", failure="language:program", detail="too long")
    done = run([home], told=told)
    assert (done.result.failure, done.result.detail) == ("language:program", "too long")
    assert done.trajectory is None and done.result.final is None and done.result.steps == 0
    assert not done.result.attention.right and done.result.attention.pair is None
    assert done.result.attention.program == "while True: pass"


def test_a_target_that_no_camera_sees_is_a_counted_failure(run, loop, home, monkeypatch):
    empty = np.zeros((0, 3), np.float32)
    monkeypatch.setattr("codediffuser.eval.rollout.workspace_cloud", lambda task, views: empty)
    result = run([home]).result
    assert result.failure == "attention:hidden"
    assert "hidden from the cameras" in result.detail
    assert result.attention.right and result.steps == 0


def test_zeroed_attention_leaves_no_trace_of_the_targets(run, loop, home):
    run([home], max_steps=2, stress="zeroed")
    cloud, _ = loop.policy.seen[0]
    assert not cloud[:, 3:].any()


def test_swapped_attention_takes_points_away(run, loop, home):
    run([home], max_steps=1)
    clean, _ = loop.policy.seen[0]
    run([home], max_steps=1, stress="swapped", swap_share=0.5)
    swapped, _ = loop.policy.seen[0]
    assert not np.array_equal(clean, swapped)
    assert swapped[:, 3].any()


def test_what_never_moved_was_never_a_success(task, scene, run, home):
    done = run([home], max_steps=3)
    pairs = [(scene.target.pick, scene.target.place)]
    assert success_holds(task, scene, done.trajectory, pairs) == [False] * 4


def test_film_shows_the_attended_battery_in_both_pictures(task, run, expert_actions, scene):
    from codediffuser.datagen.rendering import Renderer
    from codediffuser.eval.film import film

    done = run(expert_actions, max_steps=9)
    renderer = Renderer(task, film_cameras(task))
    words = {
        "instruction": scene.instruction.text,
        "attended": ("battery", "slot"),
        "holds": done.holds,
    }
    shots = list(film(renderer, scene, done.trajectory, done.field, **words))
    plain = list(film(renderer, scene, done.trajectory, type(done.field)([], {}), **words))
    assert len(shots) == 4  # moments 0, 4, 8 and the last
    frame, picture = shots[0]
    assert frame.shape == (320, 640, 3) and picture.shape == (240, 320, 3)
    changed = (frame != plain[0][0]).any(axis=2)
    assert changed[:240, :320].sum() > 30 and changed[:240, 320:].sum() > 30
