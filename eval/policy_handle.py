"""What a rollout asks of a policy, and a trained checkpoint behind it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np

from codediffuser.datasets.features import POINTS, STATE


class PolicyHandle(Protocol):
    """A policy that is called once per control step."""

    @property
    def needs_observation(self) -> bool:
        """Whether the next call of `act` reads an observation; if not, none is made."""

    def reset(self, seed: int) -> None:
        """Begin a new rollout; the same seed and observations give the same actions."""

    def act(self, points: np.ndarray | None, state: np.ndarray | None) -> np.ndarray:
        """Return the next action (10,) float32, absolute in the world; see `ACTION_NAMES`.

        Args:
            points: (N, 5) float32 policy cloud, or None when no observation is needed.
            state: (10,) float32 laid out like the action, or None likewise.
        """


class CheckpointPolicy:
    """A trained policy with its own normalisation, on one thread of the CPU or on a GPU.

    Args:
        checkpoint: Any path that `load_policy` takes.
        device: torch device.
        num_inference_steps: Denoising steps; None keeps the checkpoint's.

    Raises:
        CheckpointError: It is missing, damaged or of another policy.
    """

    def __init__(
        self, checkpoint: Path, *, device: str = "cpu", num_inference_steps: int | None = None
    ) -> None:
        from codediffuser.training.checkpoint import load_policy

        self._policy: Any
        self._policy, self._preprocess, self._postprocess = load_policy(checkpoint, device=device)
        if num_inference_steps is not None:
            self._policy.config.num_inference_steps = num_inference_steps

    @property
    def needs_observation(self) -> bool:
        """Whether the next plan will read the observation of this control step."""
        return bool(self._policy.needs_observation)

    def reset(self, seed: int) -> None:
        """Forget the rollout before and seed the noise."""
        self._policy.reset(seed=seed)

    def act(self, points: np.ndarray | None, state: np.ndarray | None) -> np.ndarray:
        """See `PolicyHandle.act`."""
        import torch

        batch: dict[str, Any] = {}
        if points is not None and state is not None:
            cloud = torch.from_numpy(points).reshape(1, -1)
            batch = self._preprocess({POINTS: cloud, STATE: torch.from_numpy(state)[None]})
        with torch.inference_mode():
            action = self._postprocess(self._policy.select_action(batch))
        return np.asarray(action[0].cpu().numpy(), dtype=np.float32)
