"""H.264 films that play in every browser."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from codediffuser.errors import ShapeError
from codediffuser.files import atomic_path


def write_video(frames: Iterable[np.ndarray], path: Path, *, fps: float) -> int:
    """Encode H.264 mp4 that plays in every browser, whole or not at all.

    Args:
        frames: (H, W, 3) uint8, all of one even size; taken one by one.
        path: Ends with `.mp4`.
        fps: Frames per second.

    Returns:
        Number of frames written.

    Raises:
        ShapeError: There is no frame, or one has another or an odd size.
    """
    import av

    with atomic_path(path) as partial:
        count = 0
        with av.open(str(partial), "w", options={"movflags": "+faststart"}) as container:
            # One thread: several rollouts are encoded at once, one per worker.
            options = {"crf": "27", "preset": "veryfast", "threads": "1"}
            rate = Fraction(fps).limit_denominator(1000)
            stream = container.add_stream("libx264", rate=rate, options=options)
            stream.pix_fmt = "yuv420p"
            for rgb in _one_size(frames):
                stream.height, stream.width = rgb.shape[:2]
                container.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
                count += 1
            if count == 0:
                raise ShapeError(f"{path}: expected at least one frame, got none")
            container.mux(stream.encode(None))
    return count


def _one_size(frames: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    shape: tuple[int, ...] | None = None
    for rgb in frames:
        shape = shape or rgb.shape
        if rgb.shape != shape or rgb.shape[0] % 2 or rgb.shape[1] % 2:
            raise ShapeError(
                f"video frames: expected one even size like {shape}, got {rgb.shape}; "
                "H.264 with 4:2:0 colour has no odd sizes"
            )
        yield np.ascontiguousarray(rgb)
