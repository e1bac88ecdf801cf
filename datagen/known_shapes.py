"""The bodies of a task, each computed once: one takes milliseconds, a scene holds a dozen."""

from __future__ import annotations

from codediffuser.datagen.scene import ObjectSpec
from codediffuser.datagen.task import Geometry, Task


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
            self._known[key] = self._task.geometry(obj)
        return self._known[key]
