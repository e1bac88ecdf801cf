"""Reads episode folders lazily: the manifest, the poses, and one frame at a time."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codediffuser.datagen import episode_format as fmt
from codediffuser.datagen import ros_messages as ros
from codediffuser.datagen.episode_format import METRES_PER_MM, Camera, EpisodeManifest
from codediffuser.datagen.log_reader import READ_ERRORS, LogReader
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.trajectory import Trajectory
from codediffuser.errors import ConfigError, EpisodeError, SchemaVersionError
from codediffuser.files import sha256_file


@dataclass(frozen=True, slots=True)
class Frame:
    """What the cameras saw at one control step, before its action."""

    index: int
    time_s: float
    rgb: dict[str, np.ndarray]
    """(H, W, 3) uint8 by camera; empty when colour was not asked for."""
    depth_m: dict[str, np.ndarray]
    """(H, W) float32 by camera that gives depth, along the optical axis, 0 for no reading; empty
    when not asked."""
    depth_mm: dict[str, np.ndarray]
    """The same as it is stored, (H, W) uint16."""


class Episode:
    """One episode folder. Build it with `Episode.open`.

    It holds no open file: every read opens the log, so an episode can be shared and pickled.
    """

    def __init__(self, folder: Path, manifest: EpisodeManifest) -> None:
        self.folder = folder
        self.manifest = manifest
        self._log = LogReader(folder / fmt.LOG, manifest.hz)

    @classmethod
    def open(cls, folder: Path, *, verify: bool = False) -> Episode:
        """Open an episode and check that its files are all there.

        Args:
            folder: `RUN/episodes/<id>`.
            verify: Also compare every file with its recorded hash, which reads all bytes.

        Raises:
            EpisodeError: A file is missing, has another size, or another hash.
        """
        manifest = load_manifest(folder)
        episode = cls(folder, manifest)
        for name, record in manifest.files.items():
            path = folder / name
            size = path.stat().st_size if path.is_file() else None
            if size != record.bytes:
                found = "no file" if size is None else f"{size} bytes"
                raise EpisodeError(
                    f"{path}: expected {record.bytes} bytes, found {found}; {episode.remedy}"
                )
            if verify and sha256_file(path) != record.sha256:
                raise EpisodeError(
                    f"{path}: its content is not what was written (SHA-256 differs from "
                    f"{fmt.MANIFEST}); {episode.remedy}"
                )
        return episode

    @property
    def id(self) -> str:
        """Id of the episode; for a simulated one, that of its scene."""
        return self.manifest.id

    @property
    def num_frames(self) -> int:
        """T: observations, each followed by one action."""
        return self.manifest.frames

    @property
    def hz(self) -> int:
        """Frames per second."""
        return self.manifest.hz

    @property
    def log_path(self) -> Path:
        """The MCAP file."""
        return self._log.path

    @property
    def remedy(self) -> str:
        """What to do when the folder is damaged."""
        made_here = self.manifest.source == "simulation" and self.manifest.recording is None
        verb = "demo" if made_here else "import"
        return f"delete the folder {self.folder} and run {verb} again"

    @functools.cached_property
    def scene(self) -> SceneSpec:
        """The configuration that was reset to; `EpisodeError` when none was stored."""
        if fmt.SCENE not in self.manifest.files:
            raise EpisodeError(
                f"{self.folder}: a {self.manifest.source} episode without scene file; label it "
                "in the browser, or name its scene under 'scenes:' in import.yaml and import again"
            )
        return SceneSpec.load(self.folder / fmt.SCENE)

    @functools.cached_property
    def trajectory(self) -> Trajectory:
        """Simulator states; `EpisodeError` when none were stored, as for a real recording."""
        if fmt.STATES not in self.manifest.files:
            raise EpisodeError(
                f"{self.folder}: a {self.manifest.source} episode without simulator states"
            )
        return Trajectory.load(self.folder / fmt.STATES)

    @functools.cached_property
    def cameras(self) -> dict[str, Camera]:
        """Calibrated cameras that stand still, by name, in the order of the manifest."""
        names = [c.name for c in self.manifest.cameras if c.calibrated and not c.moving]
        with self._reading():
            return self._log.cameras(names)

    @property
    def depth_cameras(self) -> dict[str, Camera]:
        """Those of `cameras` that give depth: what clouds are made from."""
        depth = {c.name for c in self.manifest.cameras if c.depth}
        return {name: camera for name, camera in self.cameras.items() if name in depth}

    def camera_poses(self, name: str) -> np.ndarray:
        """T_world_camera (T, 4, 4) float64 of one calibrated camera, moving or not.

        Raises:
            EpisodeError: There is no such camera, or it is not calibrated.
        """
        self._camera_names([name])
        if name in self.cameras:
            return np.tile(self.cameras[name].T_world_camera, (self.num_frames, 1, 1))
        with self._reading():
            poses = self._log.moving_camera_poses(name, self.num_frames)
        if len(poses) != self.num_frames:
            raise EpisodeError(f"{self.folder}: camera '{name}' is not calibrated in every frame")
        return np.stack(poses)

    def camera_info(self, name: str) -> tuple[np.ndarray, int, int]:
        """K (3, 3) float64 in pixels, width and height of one calibrated camera.

        Raises:
            EpisodeError: There is no such camera, or it is not calibrated.
        """
        self._camera_names([name])
        if name in self.cameras:
            camera = self.cameras[name]
            return camera.K, camera.width, camera.height
        with self._reading():
            info = self._log.camera_info(name)
        if info is None:
            raise EpisodeError(f"{self.folder}: camera '{name}' is not calibrated")
        return info

    @functools.cached_property
    def _low_dim(self) -> tuple[np.ndarray, np.ndarray]:
        """State and actions, both (T, n) float32, from one pass over the log."""
        with self._reading():
            return self._log.state_and_actions(self.manifest.motion, self.num_frames)

    @property
    def state(self) -> np.ndarray:
        """(T, n) float32, as `manifest.motion` names the columns.

        By default n = 10: measured hand pose (xyz m, rotation-6D) and mean finger opening, m.
        """
        return self._low_dim[0]

    @property
    def actions(self) -> np.ndarray:
        """(T, m) float32, action k follows frame k; by default commanded hand pose and opening."""
        return self._low_dim[1]

    def frame(
        self,
        k: int,
        cameras: Sequence[str] | None = None,
        *,
        color: bool = True,
        depth: bool = True,
    ) -> Frame:
        """Read one frame through the log's index.

        Args:
            k: Number of the frame; negative counts from the end.
            cameras: Which cameras; None for all.
            color: Whether to read colour.
            depth: Whether to read depth.

        Raises:
            EpisodeError: No such frame or camera, or the log is damaged.
        """
        index = k + self.num_frames if k < 0 else k
        if not 0 <= index < self.num_frames:
            raise EpisodeError(f"{self.folder}: no frame {k}; it has {self.num_frames} frames")
        return next(self.frames(cameras, index, index + 1, color=color, depth=depth))

    def frames(
        self,
        cameras: Sequence[str] | None = None,
        start: int = 0,
        stop: int | None = None,
        *,
        color: bool = True,
        depth: bool = True,
    ) -> Iterator[Frame]:
        """Stream frames in time order; memory does not grow with the episode.

        Args:
            cameras: Which cameras; None for all.
            start: First frame.
            stop: Frame to stop before; None for the end.
            color: Whether to read colour.
            depth: Whether to read depth.

        Raises:
            EpisodeError: No such camera, a picture is missing, or the log is damaged.
        """
        names = self._camera_names(cameras)
        with_depth = {c.name for c in self.manifest.cameras if c.depth}
        stop = self.num_frames if stop is None else min(stop, self.num_frames)
        color_topics = {fmt.color_topic(n): n for n in names} if color else {}
        depth_topics = {fmt.depth_topic(n): n for n in names if depth and n in with_depth}
        wanted = len(color_topics) + len(depth_topics)
        if not wanted:
            yield from (self._empty_frame(k) for k in range(start, stop))
            return
        with self._reading():
            messages = self._log.messages([*color_topics, *depth_topics], start, stop)
            for k in range(start, stop):
                frame = self._empty_frame(k)
                for _ in range(wanted):
                    topic, data = next(messages, ("", b""))
                    if topic in color_topics:
                        frame.rgb[color_topics[topic]] = ros.decode_color(data)
                    elif topic in depth_topics:
                        name, depth_mm = depth_topics[topic], ros.decode_depth(data)
                        frame.depth_mm[name] = depth_mm
                        frame.depth_m[name] = depth_mm * METRES_PER_MM
                if len(frame.rgb) != len(color_topics) or len(frame.depth_m) != len(depth_topics):
                    raise EpisodeError(f"frame {k} lacks a picture")
                yield frame

    def _empty_frame(self, k: int) -> Frame:
        return Frame(k, k / self.hz, {}, {}, {})

    def _camera_names(self, cameras: Sequence[str] | None) -> list[str]:
        known = [c.name for c in self.manifest.cameras]
        for name in cameras or ():
            if name not in known:
                raise EpisodeError(f"{self.folder}: no camera '{name}'; it has {', '.join(known)}")
        return known if cameras is None else list(cameras)

    @contextlib.contextmanager
    def _reading(self) -> Iterator[None]:
        """Turn whatever damaged bytes lead to into one `EpisodeError`."""
        try:
            yield
        except EpisodeError as error:
            if str(self.folder) in str(error):
                raise
            raise EpisodeError(f"{self.log_path}: {error}; {self.remedy}") from None
        except READ_ERRORS as error:
            size = self.log_path.stat().st_size if self.log_path.is_file() else 0
            raise EpisodeError(
                f"{self.log_path}: cannot be read ({type(error).__name__}: {error}); expected "
                f"{self.manifest.files[fmt.LOG].bytes} bytes, found {size}; {self.remedy}"
            ) from error


def list_episodes(run: Path) -> list[Path]:
    """Folders of all episodes of a run, sorted by id; none when there are none yet."""
    return sorted(
        path
        for path in (run / fmt.EPISODES).glob("*")
        if not path.name.startswith(".") and (path / fmt.MANIFEST).is_file()
    )


def load_manifest(folder: Path) -> EpisodeManifest:
    """Read `episode.json` of a folder.

    Raises:
        EpisodeError: The folder or its manifest is missing or damaged.
        SchemaVersionError: The manifest was written by a newer codediffuser.
    """
    path = folder / fmt.MANIFEST
    if not path.is_file():
        raise EpisodeError(
            f"{folder}: no episode here, {fmt.MANIFEST} is missing; expected a folder "
            f"RUN/{fmt.EPISODES}/<id> that demo or import has written"
        )
    try:
        manifest = EpisodeManifest.load(path)
    except SchemaVersionError:
        raise
    except ConfigError as error:
        raise EpisodeError(f"{error}; delete the folder {folder} and make it again") from None
    if fmt.LOG not in manifest.files:
        raise EpisodeError(
            f"{path}: lists no {fmt.LOG}; delete the folder {folder} and make it again"
        )
    return manifest
