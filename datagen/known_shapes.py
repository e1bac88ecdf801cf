"""The bodies of a task, each computed once: one takes milliseconds, a scene holds a dozen."""

from __future__ import annotations

import gc

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
        if key not in self._known:
            if len(self._known) >= KEPT:
                self._forget_older_half()
            self._known[key] = self._task.geometry(obj)
        return self._known[key]

    def _forget_older_half(self) -> None:
        for key in list(self._known)[: KEPT // 2]:
            del self._known[key]
        # Parts of a mesh refer to each other in circles. Left to itself, Python looks for such in a
        # process of this size once in some 250 scenes, when half a gigabyte of mugs has gathered.
        gc.collect()
