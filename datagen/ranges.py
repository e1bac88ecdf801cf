"""Ranges in YAML files: `[low, high]`, checked when the file is read."""

from __future__ import annotations

from typing import Annotated, TypeVar

from pydantic import AfterValidator

N = TypeVar("N", int, float)


def _ascending(limits: tuple[N, N]) -> tuple[N, N]:
    low, high = limits
    if not low <= high:
        raise ValueError("expected [low, high] with low <= high")
    return limits


Range = Annotated[tuple[float, float], AfterValidator(_ascending)]
"""Low and high of a length, an angle, a share, ..."""
CountRange = Annotated[tuple[int, int], AfterValidator(_ascending)]
"""Low and high of a number of things, both possible."""
