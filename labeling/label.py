"""Attention labels: which thing and which place a demonstration attends to, and how each moves."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

import numpy as np

Role = Literal["pick", "place"]
ROLES: tuple[Role, ...] = ("pick", "place")
"""Order of the attention channels everywhere."""


@dataclass(frozen=True, slots=True)
class Provenance:
    """Who or what set a label."""

    source: Literal["simulator", "human", "features", "program"]
    labeler: str
    """Name of the person or of the component."""
    tool_version: str
    confidence: float = 1.0
    created_at: str | None = None
    """ISO 8601, UTC. None for labels from stored states: the same whenever they are made."""


@dataclass(frozen=True, slots=True)
class AttentionLabel:
    """One target of an episode."""

    role: Role
    category: str
    instance_id: str
    """Id of the object or place in the scene, or of the cluster it was chosen from."""
    points_world: np.ndarray
    """(N, 3) float32, metres: the target's points at frame 0."""
    follows: str | None
    """Id of the object whose motion carries the points; None for a target that stands still."""
    provenance: Provenance


def utc_now() -> str:
    """The time for provenance: ISO 8601, UTC, whole seconds."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
