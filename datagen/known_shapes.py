"""The bodies of a task, each computed once: one takes milliseconds, a scene holds a dozen."""

from __future__ import annotations

from codediffuser.datagen.scene import ObjectSpec
from codediffuser.datagen.task import Geometry, Task

KEPT = 64
"""How many are kept: enough for all books; mugs, of which no two are the same, must not pile up."""


class Shapes:
    """A task's geometries, each computed once: a scene holds a dozen bodies of two shapes.

    Args:
        task: Whose objects they are.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._known: dict[object, Geometry] = {}

    def of(self, obj: ObjectSpec) -> Geometry:
        """The geometry of an object, by what `Task.geometry` may look at."""
        sizes = tuple(sorted(obj.shape.items()))
        written = (obj.label, obj.color_rgb) if obj.label is not None else None
        key = (obj.category, sizes, obj.fixed, obj.place is None, written)
        # Taken out and put in again: the first is always the one that was not asked for longest.
        known = self._known.pop(key, None)
        self._known[key] = self._task.geometry(obj) if known is None else known
        if len(self._known) > KEPT:
            del self._known[next(iter(self._known))]
        return self._known[key]
