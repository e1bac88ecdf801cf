"""What an evaluation is made of: settled once, checked on continuing, known to every worker."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import Task, get_task
from codediffuser.datagen.task_config import CameraConfig
from codediffuser.datasets.clouds import CloudConfig
from codediffuser.datasets.export_meta import cloud_config, load_dataset_document
from codediffuser.errors import CheckpointError, ConfigError
from codediffuser.eval.results import AttentionFrom, EvalSettings, Stress
from codediffuser.files import remove_partials, sha256_file, sha256_json
from codediffuser.schema import Document
from codediffuser.seeding import Stage

PLAN_FILE = "plan.json"
MAY_DIFFER = ("num_scenes", "checkpoint")
"""More scenes continue an evaluation, and a checkpoint that moved is known by its bytes."""


class EvalPlan(Document):
    """Everything that fixes an evaluation (`schema: codediffuser.eval_plan/1`)."""

    KIND: ClassVar[str] = "eval_plan"
    VERSION: ClassVar[int] = 1

    settings: EvalSettings
    cloud: CloudConfig
    """Of the dataset that the policy was trained on."""

    def task_object(self) -> Task:
        """Build the task."""
        return get_task(self.settings.task)

    def cameras(self, task: Task) -> CameraConfig:
        """The task's cameras at the resolution of the demonstrations."""
        size = {"width": self.settings.image_width, "height": self.settings.image_height}
        return task.config.cameras.model_copy(update=size)

    def scene(self, task: Task, index: int) -> SceneSpec:
        """Draw one scene; its address keeps it apart from all scenes of collection."""
        return sample_scene(
            task,
            root_seed=self.settings.root_seed,
            index=index,
            stage=Stage.EVAL_SCENE,
            split="eval",
            variant=self.settings.variant,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class EvalOptions:
    """What a user chooses."""

    checkpoint: Path | None = None
    """Any path of a checkpoint; None takes the newest under `RUN/checkpoints`."""
    name: str | None = None
    """Folder under `RUN/eval`; None makes it of checkpoint, attention and stress."""
    attention: AttentionFrom = "language"
    language_model: str = "builtin"
    """Registered name of who writes the programs."""
    stress: Stress = "none"
    swap_share: float = 0.15
    num_scenes: int = 50
    variant: str = "sim"
    """Which ranges of the task's YAML the scenes are drawn from."""
    seed: int = 0
    image_size: tuple[int, int] | None = None
    """Width and height; None takes that of the run's demonstrations."""
    max_steps: int | None = None
    """Control steps; None takes the task's."""
    num_inference_steps: int | None = None
    """Denoising steps; None keeps the checkpoint's."""


def plan_evaluation(run: Path, options: EvalOptions) -> EvalPlan:
    """Settle an evaluation from a run folder and a user's choices; nothing is written.

    Raises:
        CheckpointError: There is no checkpoint.
        DatasetError: Neither checkpoint nor export tells the task and how clouds are made.
        ConfigError: An option is out of range.
    """
    if options.num_scenes < 1:
        raise ConfigError(f"--num-episodes: expected at least 1, got {options.num_scenes}")
    if not 0 < options.swap_share <= 1:
        raise ConfigError(f"--swap-share: expected a share in (0, 1], got {options.swap_share}")
    from codediffuser.training.checkpoint import find_model

    checkpoint = find_model(options.checkpoint or newest_training(run))
    task_name, cloud = _learnt(checkpoint, run / "lerobot")
    task = get_task(task_name)
    width, height = options.image_size or _demonstrated_size(run, task)
    swapped = options.stress == "swapped"
    settings = EvalSettings(
        task=task.name,
        variant=options.variant,
        checkpoint=str(checkpoint),
        checkpoint_sha256=hash_folder(checkpoint),
        attention=options.attention,
        stress=options.stress,
        language_model=options.language_model if options.attention == "language" else None,
        swap_share=options.swap_share if swapped else 0.0,
        root_seed=options.seed,
        num_scenes=options.num_scenes,
        max_steps=options.max_steps or task.config.max_steps,
        image_width=width,
        image_height=height,
        num_inference_steps=options.num_inference_steps,
    )
    return EvalPlan(settings=settings, cloud=cloud)


def evaluation_folder(run: Path, plan: EvalPlan, name: str | None = None) -> Path:
    """Where an evaluation goes: `RUN/eval/<training>-<attention>[-<stress>]` unless named."""
    if name is None:
        settings = plan.settings
        stress = {"none": "", "zeroed": "-zeroed", "swapped": f"-swapped{settings.swap_share:.0%}"}
        training = Path(settings.checkpoint).parent.parent.name
        name = f"{training}-{settings.attention}{stress[settings.stress]}".replace("%", "")
    return run / "eval" / name


def claim_folder(folder: Path, plan: EvalPlan, *, overwrite: bool = False) -> None:
    """Make `folder` this evaluation's, or see that it is already.

    Raises:
        ConfigError: It holds an evaluation with other settings; the message names them.
    """
    path = folder / PLAN_FILE
    if overwrite and path.is_file():
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    remove_partials(folder)
    remove_partials(folder / "rollouts")
    if path.is_file():
        earlier = EvalPlan.load(path)
        differing = _differing(earlier, plan)
        if differing:
            raise ConfigError(
                f"{folder}: holds rollouts with other settings ({'; '.join(differing)}); choose "
                "another --name, or --overwrite"
            )
    plan.save(path)


def newest_training(run: Path) -> Path:
    """The folder under `RUN/checkpoints` whose newest checkpoint is the most recent.

    Raises:
        CheckpointError: There is none.
    """
    from codediffuser.training.checkpoint import latest_checkpoint

    root = run / "checkpoints"
    found = sorted(root.iterdir()) if root.is_dir() else []
    dated = [(p.stat().st_mtime, f) for f in found if f.is_dir() and (p := latest_checkpoint(f))]
    if not dated:
        raise CheckpointError(
            f"{root}: no checkpoint; train one with 'codediffuser train {run}', or give "
            "--checkpoint"
        )
    return max(dated)[1]


def hash_folder(folder: Path) -> str:
    """SHA-256 over names and bytes of all files under a folder."""
    return sha256_json(
        {
            p.relative_to(folder).as_posix(): sha256_file(p)
            for p in sorted(folder.rglob("*"))
            if p.is_file()
        }
    )


def _learnt(checkpoint: Path, dataset: Path) -> tuple[str, CloudConfig]:
    """Name of the task and how clouds are made, as the policy learnt them.

    A checkpoint of `codediffuser train` says both. One of `lerobot-train`, or of a dataset that
    LeRobot's tools edited, lacks one or the other: then the run's dataset is asked.
    """
    from codediffuser.training.checkpoint import POLICY_FILE
    from codediffuser.training.policy_document import load_policy_document

    if not (checkpoint / POLICY_FILE).is_file():
        document = load_dataset_document(dataset)
        return document.task, document.cloud or cloud_config(dataset)
    policy = load_policy_document(checkpoint)
    return policy.task or load_dataset_document(dataset).task, policy.cloud


def _demonstrated_size(run: Path, task: Task) -> tuple[int, int]:
    """Width and height of the run's pictures, or the task's own when no episode is there."""
    from codediffuser.datagen.episode import Episode, list_episodes

    folders = list_episodes(run)
    if not folders:
        return task.config.cameras.width, task.config.cameras.height
    camera = next(iter(Episode.open(folders[0]).cameras.values()))
    return camera.width, camera.height


def _differing(earlier: EvalPlan, now: EvalPlan) -> list[str]:
    found = []
    for name in EvalSettings.model_fields:
        before, after = getattr(earlier.settings, name), getattr(now.settings, name)
        if name not in MAY_DIFFER and before != after:
            found.append(f"{name} {before}, now {after}")
    if earlier.cloud != now.cloud:
        found.append("the size of the policy's cloud")
    return found
