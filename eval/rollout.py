"""One policy in one scene: closed loop in the simulator, from words or targets to an outcome."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from codediffuser.datagen.scene import Pair, SceneSpec, Target
from codediffuser.datagen.task import Check, Task
from codediffuser.datagen.task_config import CameraConfig
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.datagen.views import (
    Moment,
    MomentView,
    join_moments,
    moment_at,
    state_row,
)
from codediffuser.datasets.clouds import CloudConfig
from codediffuser.errors import LabelError, RenderError
from codediffuser.eval.attention_source import AttentionSource, Choice
from codediffuser.eval.observe import (
    Observer,
    depth_views,
    object_poses,
    workspace_cloud,
)
from codediffuser.eval.policy_handle import PolicyHandle
from codediffuser.eval.results import AttentionRecord, Judgement, RolloutResult, Stress
from codediffuser.files import sha256_json
from codediffuser.labeling.attention import AttentionField
from codediffuser.labeling.ground_truth import ground_truth_labels
from codediffuser.seeding import Stage, int_seed, rng_for

MOVED_M = 0.01
"""An object that never moved as far cannot have come to succeed."""

HIDDEN, BLIND, NOT_FINITE = "attention:hidden", "camera:sees_nothing", "policy:not_finite"
"""Failures beside those of language and those that the task names by phase."""


@dataclass(frozen=True, slots=True)
class RolloutOptions:
    """How a rollout is run, beside its scene and policy."""

    max_steps: int
    """Control steps; the last one is judged."""
    stress: Stress = "none"
    swap_share: float = 0.0


@dataclass(frozen=True, slots=True)
class RolloutRun:
    """A finished rollout with all that a film of it needs."""

    scene: SceneSpec
    result: RolloutResult
    trajectory: Trajectory | None = None
    """None when it could not begin."""
    field: AttentionField | None = None
    """What was attended to, before any stress."""
    holds: tuple[bool, ...] = ()
    """(T + 1,) whether success held at each moment."""


class PolicyFaultError(Exception):
    """The policy answered with something that is no action."""


@dataclass(slots=True)
class _Clock:
    """Where the time went, in seconds."""

    render_s: float = 0.0
    policy_s: float = 0.0
    observations: int = 0


class ClosedLoop:
    """Runs rollouts of one policy; simulator and renderer are built once.

    Args:
        task: What is to be done.
        policy: Called once per control step.
        source: Chooses the targets.
        options: Length and stress.
        cameras: Resolution and views; None takes the task's.
        cloud: Sizes of the cloud: those of the policy's dataset.

    Raises:
        SetupError: There is no usable Vulkan device.
    """

    def __init__(
        self,
        task: Task,
        policy: PolicyHandle,
        source: AttentionSource,
        options: RolloutOptions,
        *,
        cameras: CameraConfig | None = None,
        cloud: CloudConfig | None = None,
    ) -> None:
        from codediffuser.datagen.envs import physics_env
        from codediffuser.datagen.rendering import Renderer

        self.task, self.policy, self.source, self.options = task, policy, source, options
        self.cloud = cloud or CloudConfig()
        self.renderer = Renderer(task, cameras)
        self.env = physics_env(task)

    def run(self, scene: SceneSpec) -> RolloutRun:
        """Carry one rollout out.

        Whatever goes wrong with words, attention or policy is a failed result with its reason; only
        faults of the machine or of the code are raised.
        """
        started = time.perf_counter()
        self.env.reset(options={"scene": scene})
        self.renderer.set_scene(scene)
        pairs = self.source.judged_pairs(scene)
        clock = _Clock()
        choice = self.source.choose(self.task, scene)
        field, fault, detail = self._attend(scene, choice, clock)
        if field is None:
            result = RolloutResult(
                **scene_facts(scene, pairs),
                attention=_record(choice, pairs),
                failure=fault,
                detail=detail,
                wall_s=time.perf_counter() - started,
            )
            return RolloutRun(scene, result)
        trajectory, fault, detail = self._drive(scene, field, clock)
        holds = success_holds(self.task, scene, trajectory, pairs)
        result = RolloutResult(
            **scene_facts(scene, pairs),
            **self._outcome(scene, trajectory, choice, pairs, fault),
            attention=_record(choice, pairs),
            ever_success=any(holds),
            first_success_step=holds.index(True) if any(holds) else None,
            detail=detail,
            observations=clock.observations,
            ik_failures=self.env.ik_failures,
            wall_s=time.perf_counter() - started,
            render_s=clock.render_s,
            policy_s=clock.policy_s,
        )
        return RolloutRun(scene, result, trajectory, field, tuple(holds))

    def _outcome(
        self,
        scene: SceneSpec,
        trajectory: Trajectory,
        choice: Choice,
        pairs: Sequence[Pair],
        fault: str,
    ) -> dict[str, Any]:
        """Judge the last state: by what was asked, and by what was attended."""
        final = judge(self.task, scene, trajectory, pairs)
        attended = [choice.pair] if choice.pair else []
        failure = fault
        if not fault and not final.success:
            failure = self.task.failure_phase(scene, trajectory, pairs)
        return {
            "final": Judgement.from_check(final),
            "followed": judge(self.task, scene, trajectory, attended).success,
            "failure": failure or None,
            "steps": trajectory.num_steps,
        }

    def _attend(
        self, scene: SceneSpec, choice: Choice, clock: _Clock
    ) -> tuple[AttentionField | None, str, str]:
        """Label the chosen targets on what the cameras see at frame 0.

        Returns:
            The field; or None with the failure that this is counted as, and its explanation.
        """
        if choice.pair is None:
            return None, choice.failure, choice.detail
        moment, ids = self.env.view.moment(), self.env.view.object_ids
        start = object_poses(scene, ids, moment)
        pick, place = choice.pair
        aimed = scene.model_copy(update={"target": Target(pick=pick, place=place)})
        begun = time.perf_counter()
        try:
            views = depth_views(self.renderer, self.renderer.render(moment))
            clock.render_s += time.perf_counter() - begun
            cloud = workspace_cloud(self.task, views)
            labels = ground_truth_labels(self.task, aimed, start, cloud)
        except (LabelError, RenderError) as error:
            return None, HIDDEN if isinstance(error, LabelError) else BLIND, str(error)
        return AttentionField(labels, start, radius_m=self.cloud.attention_radius_m), "", ""

    def _drive(
        self, scene: SceneSpec, field: AttentionField, clock: _Clock
    ) -> tuple[Trajectory, str, str]:
        """Step the simulation; return what happened, and the fault that ended it early if any."""
        env, policy = self.env, self.policy
        seen = field
        if self.options.stress == "zeroed":
            # Without labels nothing is attended and no rows of the cloud are kept for targets.
            seen = AttentionField([], {})
        observer = self._observer(scene, seen)
        policy.reset(int_seed(rng_for(scene.seed.root, Stage.EVAL_POLICY, scene.seed.index)))
        moments, actions = [env.view.moment()], []
        failure = detail = ""
        for step in range(self.options.max_steps):
            try:
                action = self._act(observer, moments[-1], step, clock)
            except (PolicyFaultError, RenderError) as error:
                failure = NOT_FINITE if isinstance(error, PolicyFaultError) else BLIND
                detail = f"step {step}: {error}"
                break
            env.control_step(action)
            moments.append(env.view.moment())
            actions.append(action)
        return join_moments(env.view.object_ids, moments, actions), failure, detail

    def _act(self, observer: Observer, moment: Moment, step: int, clock: _Clock) -> np.ndarray:
        cloud = state = None
        if self.policy.needs_observation:
            begun = time.perf_counter()
            views = observer.views(moment)
            clock.render_s += time.perf_counter() - begun
            cloud, state = observer.cloud(moment, views, step), state_row(moment)
            clock.observations += 1
        begun = time.perf_counter()
        action = self.policy.act(cloud, state)
        clock.policy_s += time.perf_counter() - begun
        if action.shape != (10,) or not np.isfinite(action).all():
            raise PolicyFaultError(
                f"expected an action (10,) of finite numbers, got {action.shape} "
                f"{np.array2string(action, precision=3)}"
            )
        return action

    def _observer(self, scene: SceneSpec, field: AttentionField) -> Observer:
        share = self.options.swap_share if self.options.stress == "swapped" else 0.0
        return Observer(
            self.task, scene, self.env.view.object_ids, self.renderer, field, self.cloud,
            corrupt_share=share,
        )  # fmt: skip


def success_holds(
    task: Task, scene: SceneSpec, trajectory: Trajectory, pairs: Sequence[Pair]
) -> list[bool]:
    """Whether the conditions of some pair hold, at each of the T + 1 moments."""
    positions = trajectory.object_position_m
    travelled = np.linalg.norm(positions - positions[:1], axis=-1).max(axis=0)
    moved = {i for i, far in zip(trajectory.object_ids, travelled, strict=True) if far > MOVED_M}
    tried = [pair for pair in pairs if pair[0] in moved]
    if not tried:
        return [False] * len(positions)
    return [
        judge(task, scene, trajectory, tried, moment).success for moment in range(len(positions))
    ]


def judge(
    task: Task, scene: SceneSpec, trajectory: Trajectory, pairs: Sequence[Pair], moment: int = -1
) -> Check:
    """Check one moment of a trajectory, the last one unless told otherwise."""
    view = MomentView(scene, trajectory.object_ids, moment_at(trajectory, moment))
    return task.check_success(view, pairs)


def scene_facts(scene: SceneSpec, pairs: Sequence[Pair]) -> dict[str, Any]:
    """Entries of a `RolloutResult` that are known before it begins."""
    return {
        "scene_id": scene.scene_id,
        "scene_sha256": sha256_json(scene.model_dump(mode="json", by_alias=True)),
        "instruction": scene.instruction.text,
        "kind": scene.instruction.kind,
        "picks": scene.ambiguity.picks,
        "places": scene.ambiguity.places,
        "judged_pairs": tuple(pairs),
    }


def _record(choice: Choice, pairs: Sequence[Pair]) -> AttentionRecord:
    return AttentionRecord(
        pair=choice.pair,
        right=choice.pair in pairs,
        program=choice.program,
        seconds=choice.seconds,
    )
