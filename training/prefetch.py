"""Draws the next batch in the background while the present one is learnt from."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

T = TypeVar("T")


class Prefetcher(Generic[T]):
    """Keeps one item ahead: mapped files wait for the disk, not for the interpreter's lock.

    Args:
        draw: Makes the item of a step; the same step always gives the same item.
    """

    def __init__(self, draw: Callable[[int], T]) -> None:
        self._draw = draw
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="batches")
        self._ahead: dict[int, Future[T]] = {}

    def get(self, step: int) -> T:
        """Return the item of a step and begin to draw that of the next."""
        ready = self._ahead.pop(step, None) or self._worker.submit(self._draw, step)
        self._ahead = {step + 1: self._worker.submit(self._draw, step + 1)}
        return ready.result()

    def close(self) -> None:
        """Stop; an item that is being drawn is forgotten."""
        self._worker.shutdown(wait=False, cancel_futures=True)
