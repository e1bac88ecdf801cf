"""Windows around a frame: what a policy sees, and the actions that it learns to give.

They are those of LeRobot's diffusion policy: observations at t - To + 1 .. t, actions at
t - To + 1 .. t - To + H, and beyond either end of the episode its first or last frame again.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codediffuser.datasets.features import ACTION, POINTS, STATE
from codediffuser.errors import DatasetError

Batch = dict[str, np.ndarray]


class WindowSampler:
    """Gathers windows from arrays of a whole dataset; F frames, E episodes.

    Args:
        points: (F, P) float32, flat clouds.
        state: (F, 10) float32.
        action: (F, 10) float32.
        episode_starts: (E + 1,) int64.
        episodes: Positions of the episodes whose frames are sampled.
        n_obs_steps: To, observed steps.
        horizon: H, actions of a window.
        drop_last: How many frames at the end of each episode are no window's frame; short episodes
            keep their first.

    Raises:
        DatasetError: No episodes, or an episode that does not exist.
    """

    def __init__(
        self,
        points: np.ndarray,
        state: np.ndarray,
        action: np.ndarray,
        episode_starts: np.ndarray,
        *,
        episodes: Sequence[int],
        n_obs_steps: int = 2,
        horizon: int = 16,
        drop_last: int = 0,
    ) -> None:
        count = len(episode_starts) - 1
        if len(episodes) == 0 or min(episodes) < 0 or max(episodes) >= count:
            raise DatasetError(
                f"windows need episodes from 0 to {count - 1}, got {list(episodes)[:8]}"
            )
        self._points, self._state, self._action = points, state, action
        first, stop = episode_starts[:-1], episode_starts[1:]
        self._first = np.repeat(first, stop - first)
        self._last = np.repeat(stop - 1, stop - first)
        self._obs_offsets = np.arange(1 - n_obs_steps, 1)
        self._action_offsets = np.arange(1 - n_obs_steps, 1 - n_obs_steps + horizon)
        self.frames = np.concatenate(
            [np.arange(first[e], max(first[e] + 1, stop[e] - drop_last)) for e in episodes]
        )

    def __len__(self) -> int:
        return len(self.frames)

    def batch(self, frames: np.ndarray) -> Batch:
        """Windows of given frames.

        Args:
            frames: (B,) int64, numbers of frames in the dataset.

        Returns:
            `observation.points` (B, To, P), `observation.state` (B, To, 10) and `action`
            (B, H, 10), float32; `action_is_pad` (B, H) bool, true outside the episode; `index`
            (B,) int64.
        """
        frames = np.asarray(frames, dtype=np.int64)
        first, last = self._first[frames, None], self._last[frames, None]
        observed = np.clip(frames[:, None] + self._obs_offsets, first, last)
        wanted = frames[:, None] + self._action_offsets
        acted = np.clip(wanted, first, last)
        return {
            POINTS: np.asarray(self._points[observed]),
            STATE: np.asarray(self._state[observed]),
            ACTION: np.asarray(self._action[acted]),
            f"{ACTION}_is_pad": wanted != acted,
            "index": frames,
        }

    def sample(self, rng: np.random.Generator, batch_size: int) -> Batch:
        """Windows of frames drawn evenly and independently."""
        return self.batch(self.frames[rng.integers(len(self.frames), size=batch_size)])
