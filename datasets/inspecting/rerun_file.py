"""Episodes as a Rerun file: cloud, cameras, hand, state and action on one time line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from codediffuser.datasets.inspecting.episode_view import EpisodeView, hand_path
from codediffuser.errors import SetupError
from codediffuser.files import atomic_path

TIMELINE = "time"
"""Seconds from the start of each episode."""
STRIDE = 2
"""Every second frame has cloud and pictures; numbers are those of every frame."""
JPEG_QUALITY = 85


def write_rerun(views: Sequence[EpisodeView], path: Path, *, stride: int = STRIDE) -> Iterator[str]:
    """Write episodes into one `.rrd`; each lies below its id, all begin at 0 s.

    Args:
        views: The episodes.
        path: The file; it is there when all episodes are in it.
        stride: Frames from one cloud and its pictures to the next.

    Yields:
        The id of each episode that has been logged.

    Raises:
        SetupError: Rerun is not installed.
    """
    try:
        import rerun as rr
    except ImportError as error:
        raise SetupError(f"{error}; LeRobot brings it: pip install lerobot") from None
    with atomic_path(path) as partial:
        recording = rr.RecordingStream("codediffuser.inspect")
        recording.save(partial, default_blueprint=_layout(views))
        for view in views:
            _log(recording, view, stride)
            yield view.id
        recording.flush()
        recording.disconnect()


def _log(recording: Any, view: EpisodeView, stride: int) -> None:
    import rerun as rr

    root = f"episode_{view.id}"
    world = f"{root}/world"
    recording.log(world, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log(f"{root}/instruction", rr.TextDocument(view.title), static=True)
    for name, camera in view.cameras.items():
        recording.log(
            f"{world}/cameras/{name}",
            rr.Transform3D(
                translation=camera.T_world_camera[:3, 3], mat3x3=camera.T_world_camera[:3, :3]
            ),
            rr.Pinhole(
                image_from_camera=camera.K, resolution=[camera.width, camera.height],
                camera_xyz=rr.ViewCoordinates.RDF, image_plane_distance=0.12,
            ),
            static=True,
        )  # fmt: skip
    way = hand_path(view)
    if len(way):
        line = rr.LineStrips3D([way], colors=[60, 130, 220], radii=0.0015)
        recording.log(f"{world}/hand/way", line, static=True)
    _log_numbers(recording, root, view)
    for k in range(0, len(view.state), stride):
        recording.set_time(TIMELINE, duration=k / view.hz)
        shot = view.shot(k)
        cloud = rr.Points3D(shot.points_world, colors=shot.rgb, radii=0.0015)
        recording.log(f"{world}/cloud", cloud)
        for name, picture in shot.pictures.items():
            parent = f"{world}/cameras" if name in view.cameras else f"{root}/pictures"
            recording.log(f"{parent}/{name}", rr.Image(picture).compress(JPEG_QUALITY))
        if len(way):
            recording.log(f"{world}/hand/now", rr.Points3D(way[k : k + 1], radii=0.008))
    recording.reset_time()


def _log_numbers(recording: Any, root: str, view: EpisodeView) -> None:
    """All rows of state and action at once: a call per row would take most of the time."""
    import rerun as rr

    for what, values, names in zip(
        ("state", "action"), (view.state, view.action), view.names, strict=True
    ):
        if not values.shape[1]:
            continue
        recording.log(f"{root}/{what}", rr.SeriesLines(names=list(names)), static=True)
        recording.send_columns(
            f"{root}/{what}",
            indexes=[rr.TimeColumn(TIMELINE, duration=np.arange(len(values)) / view.hz)],
            columns=rr.Scalars.columns(scalars=values.astype(np.float64)),
        )


def _layout(views: Sequence[EpisodeView]) -> Any:
    """One tab per episode: the world, the pictures, the curves."""
    import rerun.blueprint as rrb

    tabs = []
    for view in views:
        root = f"episode_{view.id}"
        curves = [
            rrb.TimeSeriesView(origin=f"{root}/{what}", name=what) for what in ("state", "action")
        ]
        pictures = [
            rrb.Spatial2DView(origin=f"{root}/world/cameras/{name}", name=name)
            for name in view.cameras
        ]
        side = rrb.Vertical(*([rrb.Grid(*pictures)] if pictures else []), *curves)
        scene = rrb.Vertical(
            rrb.Spatial3DView(origin=f"{root}/world", name="world"),
            rrb.TextDocumentView(origin=f"{root}/instruction", name="instruction"),
            row_shares=[6, 1],
        )
        tabs.append(rrb.Horizontal(scene, side, column_shares=[3, 2], name=view.id))
    return rrb.Blueprint(rrb.Tabs(*tabs))
