"""Videos: pictures go straight to the encoder, and episodes are joined without decoding.

Key frames come every second picture and no picture depends on a later one, so any frame is read by
decoding at most two, and a file can be cut or joined at any episode.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import cv2
import numpy as np
from pydantic import Field, model_validator

from codediffuser.errors import DatasetError, ShapeError
from codediffuser.schema import Strict

if TYPE_CHECKING:
    import av

Codec = Literal["av1", "h264", "hevc"]
ENCODERS = {"av1": "libsvtav1", "h264": "h264", "hevc": "hevc"}
"""FFmpeg's encoder of each codec: those that LeRobot's own writer takes."""
SPEEDS = {"av1": "12", "h264": "veryfast", "hevc": "superfast"}
"""Preset of each encoder."""
CRF = {"av1": 30, "h264": 17, "hevc": 21}
"""Quality of each codec: AV1's is that of LeRobot's writer, the others come as near to the pictures
(`exporting.bench` tells)."""
WORST_CRF = {"av1": 63, "h264": 51, "hevc": 51}
PIXEL_FORMAT = "yuv420p"


class VideoConfig(Strict):
    """How colour is encoded. The defaults are those of LeRobot's writer."""

    codec: Codec = "av1"
    """`av1` is the smallest; `h264` encodes fastest and opens everywhere."""
    crf: int = Field(default=CRF["av1"], ge=0)
    """Constant quality; lower is better and larger. By default that of the codec."""
    key_frame_every: int = Field(default=2, ge=1)

    @model_validator(mode="before")
    @classmethod
    def _choose_quality(cls, given: Any) -> Any:
        if isinstance(given, Mapping) and given.get("crf") is None:
            codec = given.get("codec", "av1")
            return {**given, "crf": CRF.get(codec, CRF["av1"])}
        return given

    @model_validator(mode="after")
    def _check_quality(self) -> VideoConfig:
        if self.crf > WORST_CRF[self.codec]:
            raise ValueError(
                f"{self.codec} has qualities from 0 to {WORST_CRF[self.codec]}, got {self.crf}"
            )
        return self

    @property
    def encoder_options(self) -> dict[str, str]:
        """What FFmpeg's encoder is told."""
        options = {
            "g": str(self.key_frame_every), "crf": str(self.crf), "preset": SPEEDS[self.codec]
        }  # fmt: skip
        if self.codec == "av1":
            # Every camera has an encoder; more threads in each cost time and memory, and give the
            # same bytes. (`lookahead=0` would save a twentieth of the time, and gives others.)
            return {**options, "svtav1-params": "lp=1"}
        # One thread and no reordered frames: the same bytes on any machine, and times that start
        # at 0 without an edit list.
        options |= {"bf": "0", "threads": "1"}
        if self.codec == "hevc":
            return {**options, "x265-params": "log-level=error:pools=1:bframes=0"}
        # Otherwise x264 spreads quality over pictures by routines of the processor at hand: SSE and
        # AVX round differently, and the one for AVX-512 reads memory that nothing was written to,
        # so that the bytes changed from call to call.
        return {**options, "x264-params": "cpu-independent=1"}

    def info(self, width: int, height: int, fps: int) -> dict[str, Any]:
        """The `info` block of a video feature in LeRobot's `info.json`."""
        return {
            "video.height": height,
            "video.width": width,
            "video.codec": self.codec,
            "video.pix_fmt": PIXEL_FORMAT,
            "video.is_depth_map": False,
            "video.fps": fps,
            "video.channels": 3,
            "has_audio": False,
        }


class VideoEncoder:
    """Encodes one camera's pictures as they come; use it as a context manager.

    Args:
        path: Where the `.mp4` goes.
        config: Codec and quality.
        width: Pixels, even.
        height: Pixels, even.
        fps: Frames per second.

    Raises:
        ShapeError: The size is odd, which the pixel format cannot hold.
    """

    def __init__(self, path: Path, config: VideoConfig, width: int, height: int, fps: int) -> None:
        import av

        if width % 2 or height % 2:
            raise ShapeError(
                f"videos need even picture sizes, got {width} x {height}; export this run with "
                "--profile pointcloud, or record it at another size"
            )
        _silence(config)
        self._container: Any = av.open(str(path), "w")
        stream: Any = self._container.add_stream(
            ENCODERS[config.codec], fps, options=config.encoder_options
        )
        stream.width, stream.height = width, height
        stream.pix_fmt = PIXEL_FORMAT
        stream.time_base = Fraction(1, fps)
        self._stream = stream
        self._fps = fps
        self.frames = 0
        """Pictures taken so far; none is ever dropped."""

    def add(self, rgb: np.ndarray) -> None:
        """Encode the next picture, (H, W, 3) uint8."""
        import av

        expected = (self._stream.height, self._stream.width, 3)
        if rgb.shape != expected or rgb.dtype != np.uint8:
            raise ShapeError(f"video: expected {expected} uint8, got {rgb.shape} {rgb.dtype}")
        # Converted here, where the result depends on the pixels alone.
        frame = av.VideoFrame.from_ndarray(
            cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2YUV_I420), format=PIXEL_FORMAT
        )
        frame.pts, frame.time_base = self.frames, Fraction(1, self._fps)
        self._container.mux(self._stream.encode(frame))
        self.frames += 1

    def __enter__(self) -> VideoEncoder:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self._container.mux(self._stream.encode())
        self._container.close()


class VideoJoiner:
    """Writes several videos of one codec and size behind one another, packet by packet.

    Args:
        path: Where the `.mp4` goes.
        fps: Frames per second of all of them.
    """

    def __init__(self, path: Path, fps: int) -> None:
        import av

        path.parent.mkdir(parents=True, exist_ok=True)
        # The index in front lets players and loaders start without reading the whole file.
        self._container = av.open(str(path), "w", options={"movflags": "faststart"})
        self._stream: Any = None
        self._fps = fps
        self.frames = 0
        self.bytes = 0

    def append(self, path: Path, first: int = 0, count: int | None = None) -> int:
        """Append pictures of another file.

        Args:
            path: A video that starts, and goes on from `first`, with a key frame.
            first: Number of the first picture to take.
            count: How many; None takes all that follow.

        Returns:
            How many were appended.

        Raises:
            DatasetError: The file cannot be read, or has fewer pictures.
        """
        import av

        before = self.frames
        try:
            with av.open(str(path)) as source:
                video = source.streams.video[0]
                ticks = Fraction(1, self._fps) / Fraction(video.time_base or 1)
                if first:
                    source.seek(int(first * ticks), stream=video)
                for packet in source.demux(video):
                    if packet.pts is None:
                        continue
                    k = int(packet.pts / ticks)
                    if k < first or (count is not None and k >= first + count):
                        continue
                    self._copy(packet, video, int((before - first) * ticks))
        except (av.FFmpegError, IndexError, OSError) as error:
            raise DatasetError(f"{path}: not readable as a video: {error}") from None
        copied = self.frames - before
        if copied == 0 or (count is not None and copied != count):
            raise DatasetError(f"{path}: expected {count} pictures from {first} on, found {copied}")
        return copied

    def close(self) -> None:
        """Finish the file."""
        self._container.close()

    def _copy(self, packet: av.Packet, video: Any, shift: int) -> None:
        if self._stream is None:
            self._stream = self._container.add_stream_from_template(video, opaque=True)
            self._stream.time_base = video.time_base
        packet.pts = (packet.pts or 0) + shift
        packet.dts = (packet.dts or 0) + shift
        packet.stream = self._stream
        self.bytes += packet.size
        self.frames += 1
        self._container.mux(packet)


def count_frames(path: Path) -> int:
    """How many pictures a video holds, without decoding them.

    Raises:
        DatasetError: It is not readable.
    """
    import av

    try:
        with av.open(str(path)) as source:
            packets = source.demux(video=0)
            found = sum(packet.pts is not None for packet in packets)
    except (av.FFmpegError, IndexError, OSError) as error:
        raise DatasetError(f"{path}: not readable as a video: {error}") from None
    return found


def _silence(config: VideoConfig) -> None:
    """Keep encoders from writing their banners to stderr."""
    import logging
    import os

    logging.getLogger("libav").setLevel(logging.ERROR)
    if config.codec == "av1":
        os.environ.setdefault("SVT_LOG", "1")
