"""Moving average of a network's weights."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import torch
from torch import nn

from codediffuser.training.config import EmaConfig


class WeightAverage:
    """Keeps the average of a module's parameters; buffers are left alone.

    Args:
        module: Whose parameters are averaged. They are the average's start.
        config: Decay.
    """

    def __init__(self, module: nn.Module, config: EmaConfig) -> None:
        self._config = config
        self._weights = [p.data for p in module.parameters()]
        self._average = [w.clone() for w in self._weights]

    def update(self, step: int) -> None:
        """Take the present weights in.

        Args:
            step: Optimiser steps done so far, >= 1.
        """
        decay = min(self._config.max_decay, 1 - (1 + step) ** -self._config.power)
        torch._foreach_lerp_(self._average, self._weights, 1 - decay)

    def restart(self) -> None:
        """Take the present weights as the average."""
        torch._foreach_copy_(self._average, self._weights)

    @contextlib.contextmanager
    def applied(self) -> Iterator[None]:
        """Put the average into the module for the length of a block."""
        kept = [w.clone() for w in self._weights]
        torch._foreach_copy_(self._weights, self._average)
        try:
            yield
        finally:
            torch._foreach_copy_(self._weights, kept)
