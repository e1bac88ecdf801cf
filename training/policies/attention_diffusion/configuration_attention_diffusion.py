"""Options of the attention-conditioned diffusion policy; defaults are those of preset `cpu`."""

from __future__ import annotations

from dataclasses import dataclass, field

from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import NormalizationMode
from lerobot.optim.optimizers import AdamWConfig
from lerobot.optim.schedulers import DiffuserSchedulerConfig

from codediffuser.datasets.features import POINT_CHANNELS, POINTS
from codediffuser.errors import ConfigError
from codediffuser.labeling.label import ROLES
from codediffuser.registry import unknown_name

NUM_POINT_CHANNELS = len(POINT_CHANNELS)

# LeRobot's parser (draccus) reads no `Literal`, so closed sets are checked here.
CHOICES = {
    "frame": ("hand", "world"),
    "attention_channels": ("separate", "merged", "none"),
    "prediction_type": ("sample", "epsilon"),
    "inference_scheduler": ("DDIM", "DDPM"),
}


def _identity() -> dict[str, NormalizationMode]:
    return dict.fromkeys(("STATE", "ACTION"), NormalizationMode.IDENTITY)


@PreTrainedConfig.register_subclass("attention_diffusion")
@dataclass
class AttentionDiffusionConfig(PreTrainedConfig):
    """Point cloud with attention, proprioception and absolute hand poses in and out.

    The dataset stays absolute. The policy moves to the hand's frame and scales by itself, with
    ranges measured at the start of training and saved with the weights, so that LeRobot's
    normalising steps have nothing to do (`normalization_mapping` is identity throughout).
    """

    n_obs_steps: int = 2
    horizon: int = 16
    """Predicted actions, the first one belonging to the oldest observation."""
    n_action_steps: int = 8
    """Actions carried out before the next prediction."""
    normalization_mapping: dict[str, NormalizationMode] = field(default_factory=_identity)

    frame: str = "hand"
    """`hand` subtracts the present hand position (world axes) from points, state and actions."""
    attention_channels: str = "separate"
    """`separate` keeps one channel per role, `merged` takes the larger of them, `none` sets them to
    zero and crops without them: an ablation."""
    use_proprioception: bool = True
    """Condition on the measured hand poses and finger openings."""
    use_centroids: bool = True
    """Condition on the centre of each channel's attended points."""

    crop: bool = True
    """Look only at a random part of the attended points, and of the points near the hand."""
    crop_pick_points: int = 56
    crop_place_points: int = 40
    crop_hand_points: int = 56
    """Taken while the hand is closed. Near an open one they would show the policy that
    `augment_offset` displaced it."""
    hand_radius_m: float = 0.12
    """Points this close to the tool centre, between the finger tips, count as near the hand."""
    tool_offset_m: float = 0.1034
    """From the origin of the hand to the tool centre, along the hand's z axis."""
    trim_factor: float = 2.5
    """Attended points farther from their centre than this many median distances lose their
    attention: strays. Targets drawn out along a line stay whole: ends lie at 2. 0 trims not."""

    encoder: str = "pointnet"
    """Name in the registry of point encoders: `pointnet` or `pointnet2`."""
    encoder_dim: int = 64
    """Length of the point feature of one observation."""

    down_dims: tuple[int, ...] = (64, 128)
    kernel_size: int = 5
    n_groups: int = 8
    diffusion_step_embed_dim: int = 128
    use_film_scale_modulation: bool = True

    prediction_type: str = "sample"
    num_train_timesteps: int = 100
    beta_schedule: str = "squaredcos_cap_v2"
    beta_start: float = 0.0001
    beta_end: float = 0.02
    inference_scheduler: str = "DDIM"
    num_inference_steps: int = 12
    noise_draws: int = 2
    """Noise levels and samples per encoded observation and training step: the encoder costs more
    than one pass of the small U-Net."""
    mask_padded_actions: bool = False
    """Leave actions past the end of the episode out of the loss. Off: holding the last pose is what
    a rollout that goes on should do."""

    augment_swap_probability: float = 0.3
    """Share of training samples in which some attended points are swapped for wrong ones."""
    augment_swap_max_share: float = 0.2
    """Up to this share of each channel's attended points."""
    augment_drop_probability: float = 0.2
    """Share of training samples in which some attended points lose their attention."""
    augment_drop_max_share: float = 0.5
    augment_point_noise_m: float = 0.001
    augment_offset_probability: float = 0.5
    """Share of training samples in which an open hand is displaced, see `augment.displace_hand`."""
    augment_offset_m: float = 0.005
    """Standard deviation of that along each axis."""

    optimizer_lr: float = 1e-3
    optimizer_betas: tuple[float, float] = (0.9, 0.999)
    optimizer_eps: float = 1e-8
    optimizer_weight_decay: float = 1e-6
    optimizer_grad_clip_norm: float = 1.0
    scheduler_name: str = "cosine"
    scheduler_warmup_steps: int = 200

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, choices in CHOICES.items():
            if getattr(self, name) not in choices:
                raise ConfigError(
                    unknown_name(f"policy.{name}", str(getattr(self, name)), list(choices))
                )
        factor = 2 ** len(self.down_dims)
        if self.horizon % factor != 0:
            raise ConfigError(
                f"policy.horizon: expected a multiple of {factor} for {len(self.down_dims)} "
                f"down_dims, got {self.horizon}"
            )
        if self.n_action_steps > self.horizon - self.n_obs_steps + 1:
            raise ConfigError(
                "policy.n_action_steps: expected at most horizon - n_obs_steps + 1 = "
                f"{self.horizon - self.n_obs_steps + 1}, got {self.n_action_steps}"
            )
        if self.noise_draws < 1:
            raise ConfigError(f"policy.noise_draws: expected at least 1, got {self.noise_draws}")

    @property
    def num_attention_channels(self) -> int:
        """Attention values per point that the encoder sees."""
        return 1 if self.attention_channels == "merged" else len(ROLES)

    @property
    def observation_delta_indices(self) -> list[int]:
        """Frames of a window's observations, relative to the present."""
        return list(range(1 - self.n_obs_steps, 1))

    @property
    def action_delta_indices(self) -> list[int]:
        """Frames of a window's actions, relative to the present."""
        return list(range(1 - self.n_obs_steps, 1 - self.n_obs_steps + self.horizon))

    @property
    def reward_delta_indices(self) -> None:
        """No rewards are read."""

    def get_optimizer_preset(self) -> AdamWConfig:
        """What both our loop and stock `lerobot-train` optimise with."""
        return AdamWConfig(
            lr=self.optimizer_lr,
            betas=self.optimizer_betas,
            eps=self.optimizer_eps,
            weight_decay=self.optimizer_weight_decay,
            grad_clip_norm=self.optimizer_grad_clip_norm,
        )

    def get_scheduler_preset(self) -> DiffuserSchedulerConfig:
        """Warm-up, then cosine over the planned steps."""
        return DiffuserSchedulerConfig(
            name=self.scheduler_name, num_warmup_steps=self.scheduler_warmup_steps
        )

    def validate_features(self) -> None:
        """Check that points, state and action are there in the shapes of `datasets.features`.

        Raises:
            ConfigError: One is missing or of another shape.
        """
        points = (self.input_features or {}).get(POINTS)
        if points is None or len(points.shape) != 1 or points.shape[0] % NUM_POINT_CHANNELS:
            raise ConfigError(
                f"policy input '{POINTS}': expected a flat vector of N * {NUM_POINT_CHANNELS} "
                f"({', '.join(POINT_CHANNELS)}), got {points and points.shape}; convert with "
                "'codediffuser convert --profile pointcloud'"
            )
        for name, feature in (
            ("observation.state", self.robot_state_feature),
            ("action", self.action_feature),
        ):
            if feature is None or tuple(feature.shape) != (10,):
                raise ConfigError(
                    f"policy feature '{name}': expected shape (10,), hand pose and finger opening, "
                    f"got {feature and feature.shape}"
                )
