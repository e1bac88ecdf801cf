"""What the large window shows: clusters from above, a camera's picture with outlines, or 3D.

All nodes belong to one client, so each tab has its own selection. A selection changes colours of
existing nodes only, a few bytes each; geometry is sent once per episode.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import viser

from codediffuser.labeling.gui.draft import Selection
from codediffuser.labeling.gui.episode_scene import EpisodeScene
from codediffuser.labeling.gui.picking import Picker
from codediffuser.labeling.gui.pictures import outlines
from codediffuser.labeling.gui.planes import PicturePlane, Plane, TopPlane, Viewpoint
from codediffuser.poses import matrix_to_quat_wxyz

ClientHandle = viser.ClientHandle
"""A browser tab, as viser knows it."""

GREY = (128, 128, 128)
PALE = (205, 205, 205)
"""Taken places."""
ORANGE = (255, 77, 0)
BLUE = (0, 40, 255)
RED = (225, 0, 0)
GREEN = (0, 200, 60)
WHITE = (235, 235, 235)

CELL_SHARE = 1 / 110
"""Fineness of what lights up under the mouse, as a share of the shorter side of the view."""

HOVER_M = 0.010
"""How near to an instance the mouse lights it up, seen from above."""

MARK_SHARE = 0.012
"""Size of a reference's dot, as a share of the picture's height."""

HOVER_SHARE = 0.02
"""The same in a picture, as a share of its height."""


_Lift = Callable[[np.ndarray], np.ndarray]
"""Takes points (N, 2) of a plane to the world."""


class View(Protocol):
    """One way to show an episode."""

    plane: Plane | None
    """What clicks are judged in; None for a view that is only looked at."""
    picker: Picker | None

    def recolor(self, selection: Selection) -> None:
        """Show which instances are selected."""

    def viewpoint(self, aspect: float) -> Viewpoint:
        """From where it is seen."""

    def remove(self) -> None:
        """Take all its nodes away."""


@dataclass(slots=True)
class _Marks:
    """Nodes of one instance in the plan."""

    cloud: Any
    dot: Any
    label: Any
    taken: bool
    height_m: float


class TopView:
    """Instances as clusters seen from above, with a dot at each middle."""

    def __init__(self, client: viser.ClientHandle, scene: EpisodeScene) -> None:
        assert scene.task is not None
        box = scene.task.config.workspace
        self.picker: Picker | None = scene.top
        self.plane: Plane | None = TopPlane.around(
            scene.instances, np.array(box.low_m), np.array(box.high_m)
        )
        self._root = client.scene.add_frame("/top", show_axes=False)
        self._marks = {
            instance.id: self._add(client, number, instance, points)
            for number, (instance, points) in enumerate(
                zip(scene.instances, scene.clusters, strict=True)
            )
        }
        span = float(np.min(self.plane.high - self.plane.low))
        plane, top = self.plane, max((m.height_m for m in self._marks.values()), default=0.0)
        hulls = self.picker.territories(span * CELL_SHARE, HOVER_M)
        # Over everything, so that the halo of one slot is not hidden by its neighbours.
        lids = (lambda at: plane.at(at, top), lambda at: plane.at(at, top + 0.003))
        _add_territories(client, "/top/near", hulls, lids)
        self._shown: Selection = ()

    def _add(
        self, client: viser.ClientHandle, number: int, instance: Any, points: np.ndarray
    ) -> _Marks:  # fmt: skip
        middle = instance.centroid_world
        cloud = client.scene.add_point_cloud(
            f"/top/{number}/cloud", points, PALE if instance.taken_by else GREY,
            point_size=0.0016, point_shape="square", point_shading="flat", precision="float32",
        )  # fmt: skip
        height = instance.points_world[:, 2].max() + 0.02
        above = np.array([[middle[0], middle[1], height]], dtype=np.float32)
        dot = client.scene.add_point_cloud(
            f"/top/{number}/dot", above, GREY if instance.taken_by else BLUE,
            point_size=0.004, point_shape="circle", point_shading="flat", precision="float32",
        )  # fmt: skip
        label = client.scene.add_label(
            f"/top/{number}/role", "", position=above[0] + np.array([0.0, 0.012, 0.0]),
            visible=False, anchor="bottom-center",
        )  # fmt: skip
        return _Marks(cloud, dot, label, bool(instance.taken_by), float(height))

    def recolor(self, selection: Selection) -> None:
        """Selected clusters orange with a red dot and the name of their role."""
        roles, before = {n: r for r, n in selection}, {n: r for r, n in self._shown}
        for name in roles.keys() | before.keys():
            if (marks := self._marks.get(name)) is None or roles.get(name) == before.get(name):
                continue
            on = name in roles
            marks.cloud.colors = np.array(ORANGE if on else PALE if marks.taken else GREY, np.uint8)
            marks.dot.colors = np.array(RED if on else GREY if marks.taken else BLUE, np.uint8)
            marks.label.text = roles.get(name, "")
            marks.label.visible = on
        self._shown = selection

    def viewpoint(self, aspect: float) -> Viewpoint:
        """From straight above."""
        assert self.plane is not None
        return self.plane.viewpoint(aspect)

    def remove(self) -> None:
        """Take all its nodes away."""
        self._root.remove()


class CameraView:
    """The photograph of one camera at frame 0 with the outline of each instance."""

    def __init__(self, client: viser.ClientHandle, scene: EpisodeScene, camera: str) -> None:
        self.camera = camera
        plane = PicturePlane(scene.cameras[camera])
        self.plane: Plane | None = plane
        self.picker: Picker | None = scene.through(camera)
        self._root = client.scene.add_frame("/photo", show_axes=False)
        shot, size = plane.camera, plane.size_m
        middle = np.array([[(shot.width - 1) / 2, (shot.height - 1) / 2]])
        rgb = scene.start.rgb[camera] if scene.start else np.zeros((2, 2, 3), np.uint8)
        client.scene.add_image(
            "/photo/picture", rgb, *size, format="jpeg", jpeg_quality=92, cast_shadow=False,
            receive_shadow=False, wxyz=matrix_to_quat_wxyz(shot.T_world_camera[:3, :3]),
            position=plane.to_world(middle)[0],
        )  # fmt: skip
        self._client = client
        self._marks: Any = None
        self._lines: dict[str, tuple[Any, bool]] = {}
        for number, instance in enumerate(scene.instances):
            lines = _outline(self.picker.points[self.picker.owner == number], plane)
            if len(lines):
                handle = client.scene.add_line_segments(
                    f"/photo/{number}", lines, WHITE, thickness=1.5, thickness_units="screen"
                )
                self._lines[instance.id] = handle, bool(instance.taken_by)
        self.recolor(())
        cell = max(1.0, round(shot.height * CELL_SHARE))
        hulls = self.picker.territories(cell, HOVER_SHARE * shot.height)
        # Rows of a picture run down, so the far lid is the upper one of the prism.
        lids = (lambda at: plane.before(at, 0.97), lambda at: plane.before(at, 0.985))
        _add_territories(client, "/photo/near", hulls, lids)

    def recolor(self, selection: Selection) -> None:
        """Outlines of selected instances green and thick, the others thin."""
        chosen = {name for _, name in selection}
        for name, (lines, taken) in self._lines.items():
            on = name in chosen
            lines.colors = np.array(GREEN if on else GREY if taken else WHITE, np.uint8)
            lines.thickness = 4.0 if on else 0.8 if taken else 1.5

    def mark(self, pixels: np.ndarray, rgb: np.ndarray) -> None:
        """Put dots of colours (N, 3) uint8 on pixels (N, 2), in place of those before."""
        if self._marks is not None:
            self._marks.remove()
            self._marks = None
        if len(pixels):
            assert isinstance(self.plane, PicturePlane)
            self._marks = self._client.scene.add_point_cloud(
                "/photo/marks", self.plane.before(pixels, 0.99).astype(np.float32), rgb,
                point_size=MARK_SHARE * self.plane.size_m[1], point_shape="circle",
                point_shading="flat", precision="float32",
            )  # fmt: skip

    def viewpoint(self, aspect: float) -> Viewpoint:
        """From where the camera stood."""
        assert self.plane is not None
        return self.plane.viewpoint(aspect)

    def remove(self) -> None:
        """Take all its nodes away."""
        self._root.remove()


class CloudView:
    """The coloured cloud of any frame, to be looked at from all sides."""

    plane: Plane | None = None
    picker: Picker | None = None

    def __init__(self, client: viser.ClientHandle, scene: EpisodeScene) -> None:
        assert scene.task is not None
        box = scene.task.config.workspace
        self._low, self._high = np.array(box.low_m), np.array(box.high_m)
        self._client = client
        self._root = client.scene.add_frame("/cloud", show_axes=False)

    def show(self, points: np.ndarray, rgb: np.ndarray) -> None:
        """Show another cloud (N, 3) with colours (N, 3) uint8."""
        self._client.scene.add_point_cloud(
            "/cloud/points", points, rgb, point_size=0.002, point_shape="circle",
            point_shading="flat", precision="float32",
        )  # fmt: skip

    def recolor(self, selection: Selection) -> None:
        """Nothing: the colours come with the cloud."""

    def viewpoint(self, aspect: float) -> Viewpoint:
        """From the side that faces the robot, from above."""
        middle = (self._low + self._high) / 2
        middle[2] = self._low[2] + 0.05
        reach = float(np.linalg.norm((self._high - self._low)[:2]))
        away = np.array([0.45, 1.0, 0.9]) / np.linalg.norm([0.45, 1.0, 0.9])
        return Viewpoint(middle + 2.0 * reach * away, middle, np.array([0.0, 0.0, 1.0]), 0.6)

    def remove(self) -> None:
        """Take all its nodes away."""
        self._root.remove()


def show_viewpoint(client: viser.ClientHandle, viewpoint: Viewpoint) -> None:
    """Put the browser's camera there."""
    distance = float(np.linalg.norm(viewpoint.look_at - viewpoint.position))
    with client.atomic():
        client.camera.up_direction = viewpoint.up
        client.camera.fov = viewpoint.fov_y_rad
        client.camera.near, client.camera.far = distance * 0.05, distance * 4
        client.camera.position = viewpoint.position
        # Setting the position moves what is looked at along, so it comes last.
        client.camera.look_at = viewpoint.look_at


def _outline(pixels: np.ndarray, plane: PicturePlane) -> np.ndarray:
    """Segments (M, 2, 3) around an instance's pixels (N, 2), in the world; M may be 0."""
    if not len(pixels):
        return np.zeros((0, 2, 3), np.float32)
    found = []
    for polygon in outlines(pixels, plane.camera.width, plane.camera.height):
        corners = plane.before(polygon)
        found.append(np.stack([corners, np.roll(corners, -1, axis=0)], axis=1))
    return np.concatenate([np.zeros((0, 2, 3)), *found]).astype(np.float32)


def _add_territories(
    client: viser.ClientHandle, name: str, hulls: list[np.ndarray], lids: tuple[_Lift, _Lift]
) -> None:
    """Invisible bodies where each instance is nearest: viser outlines the one under the mouse.

    The browser does this alone, with no round trip. Their clicks are ignored; the scene's count.
    Bodies are closed, for viser draws the outline by swelling them.
    """
    for number, hull in enumerate(hulls):
        if len(hull) < 3:
            continue
        vertices = np.concatenate([lid(hull) for lid in lids])
        # Transparent things are drawn in the order of their positions, so it must be their own.
        middle = vertices.mean(axis=0)
        mesh = client.scene.add_mesh_simple(
            f"{name}/{number}", (vertices - middle).astype(np.float32), _prism_faces(len(hull)),
            opacity=0.0, side="double", cast_shadow=False, receive_shadow=False, position=middle,
        )  # fmt: skip
        mesh.on_click(_ignore)


def _prism_faces(count: int) -> np.ndarray:
    """Triangles (M, 3) of a closed prism over a convex polygon: lower lid, upper lid, then sides.

    The polygon runs counter-clockwise seen from above the upper lid, whose corners follow those
    of the lower one.
    """
    fan = [(0, i, i + 1) for i in range(1, count - 1)]
    faces = [(a, c, b) for a, b, c in fan]
    faces += [(a + count, b + count, c + count) for a, b, c in fan]
    for i in range(count):
        j = (i + 1) % count
        faces += [(i, j, j + count), (i, j + count, i + count)]
    return np.array(faces, dtype=np.int32)


async def _ignore(event: Any) -> None:
    """Do nothing: a mesh lights up only when somebody listens to it."""
