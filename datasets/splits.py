"""Which episodes train and which validate: decided by each episode's id alone.

Adding, removing or reordering episodes never moves another one to the other side.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

from codediffuser.errors import ConfigError


def split_episodes(
    episode_ids: Sequence[str], val_share: float = 0.1
) -> tuple[list[int], list[int]]:
    """Divide episodes by the hash of their ids.

    Args:
        episode_ids: Ids in dataset order.
        val_share: Expected part that validates, in [0, 1).

    Returns:
        train: Positions in `episode_ids`, ascending.
        val: The other positions. When chance would leave a side empty although `val_share` > 0,
            one episode changes sides; a single episode trains.

    Raises:
        ConfigError: `val_share` is out of range.
    """
    if not 0.0 <= val_share < 1.0:
        raise ConfigError(f"val_share: expected a number in [0, 1), got {val_share}")
    rank = [episode_fraction(name) for name in episode_ids]
    val = [i for i, fraction in enumerate(rank) if fraction < val_share]
    by_rank = sorted(range(len(rank)), key=lambda i: rank[i])
    if len(val) == len(rank):
        val = sorted(by_rank[:-1])
    elif val_share > 0 and not val and len(rank) > 1:
        val = by_rank[:1]
    chosen = set(val)
    return [i for i in range(len(rank)) if i not in chosen], val


def episode_fraction(episode_id: str) -> float:
    """A number in [0, 1) that an id always maps to, evenly spread over ids."""
    digest = hashlib.sha256(f"codediffuser.split/1:{episode_id}".encode()).digest()
    return int.from_bytes(digest[:8], "big") / 2**64
