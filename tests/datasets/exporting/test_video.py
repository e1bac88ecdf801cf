"""Videos: every picture arrives, joined and cut files hold the same packets."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest

from codediffuser.datasets.exporting.video import (
    Codec,
    VideoConfig,
    VideoEncoder,
    VideoJoiner,
    count_frames,
)
from codediffuser.errors import DatasetError, ShapeError

FPS = 25


def encode(path: Path, count: int, codec: Codec = "h264", shade: int = 0) -> list[np.ndarray]:
    pictures = [np.full((48, 64, 3), shade + 8 * k, np.uint8) for k in range(count)]
    with VideoEncoder(path, VideoConfig(codec=codec), 64, 48, FPS) as encoder:
        for picture in pictures:
            encoder.add(picture)
    return pictures


def decode(path: Path) -> list[tuple[float, float]]:
    """Time and mean brightness of each picture."""
    with av.open(str(path)) as container:
        frames = container.decode(video=0)
        return [(float(f.time), float(f.to_ndarray(format="rgb24").mean())) for f in frames]


@pytest.mark.parametrize("codec", ["av1", "h264", "hevc"])
def test_every_picture_is_there_at_its_time(codec: Codec, tmp_path: Path) -> None:
    pictures = encode(tmp_path / "a.mp4", 7, codec)
    found = decode(tmp_path / "a.mp4")
    assert [t for t, _ in found] == pytest.approx(np.arange(7) / FPS)
    assert [v for _, v in found] == pytest.approx([p.mean() for p in pictures], abs=3)


@pytest.mark.parametrize("codec", ["av1", "h264", "hevc"])
def test_joined_episodes_follow_one_another_and_can_be_cut_out_again(
    codec: Codec, tmp_path: Path
) -> None:
    first = encode(tmp_path / "a.mp4", 5, codec)
    second = encode(tmp_path / "b.mp4", 6, codec, shade=100)
    joiner = VideoJoiner(tmp_path / "joined.mp4", FPS)
    assert [joiner.append(tmp_path / name) for name in ("a.mp4", "b.mp4")] == [5, 6]
    joiner.close()
    found = decode(tmp_path / "joined.mp4")
    assert [t for t, _ in found] == pytest.approx(np.arange(11) / FPS)
    assert [v for _, v in found] == pytest.approx([p.mean() for p in first + second], abs=3)
    cut = VideoJoiner(tmp_path / "cut.mp4", FPS)
    cut.append(tmp_path / "joined.mp4", 5, 6)
    cut.close()
    assert decode(tmp_path / "cut.mp4") == decode(tmp_path / "b.mp4")


ENCODE_NOISE = """
import sys
from pathlib import Path
import numpy as np
from codediffuser.datasets.exporting.video import VideoConfig, VideoEncoder

rng = np.random.default_rng(0)
noise = rng.integers(80, 120, (240, 360, 3), np.uint8)
with VideoEncoder(Path(sys.argv[2]), VideoConfig(codec=sys.argv[1]), 320, 240, 25) as encoder:
    for k in range(6):
        encoder.add(noise[:, 4 * k : 4 * k + 320])
"""


@pytest.mark.parametrize("codec", ["av1", "h264", "hevc"])
def test_the_bytes_do_not_depend_on_what_memory_held_before(codec: Codec, tmp_path: Path) -> None:
    for fill in ("0", "1", "90"):
        # glibc fills what it hands out and takes back with this byte, and its complement.
        environment = {**os.environ, "MALLOC_PERTURB_": fill}
        command = [sys.executable, "-c", ENCODE_NOISE, codec, str(tmp_path / f"{fill}.mp4")]
        subprocess.run(command, check=True, env=environment)
    assert len({path.read_bytes() for path in tmp_path.glob("*.mp4")}) == 1


def test_every_second_picture_is_a_key_frame(tmp_path: Path) -> None:
    encode(tmp_path / "a.mp4", 6, "av1")
    with av.open(str(tmp_path / "a.mp4")) as container:
        packets = [p for p in container.demux(video=0) if p.pts is not None]
    assert [p.is_keyframe for p in packets] == [True, False] * 3
    assert [p.pts for p in packets] == [p.dts for p in packets]


def test_odd_sizes_and_other_shapes_are_errors(tmp_path: Path) -> None:
    with pytest.raises(ShapeError, match="even picture sizes, got 63 x 48"):
        VideoEncoder(tmp_path / "a.mp4", VideoConfig(), 63, 48, FPS)
    with (
        pytest.raises(ShapeError, match=r"expected \(48, 64, 3\) uint8"),
        VideoEncoder(tmp_path / "b.mp4", VideoConfig(codec="h264"), 64, 48, FPS) as encoder,
    ):
        encoder.add(np.zeros((48, 64), np.uint8))


def test_damaged_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_bytes(b"no video")
    with pytest.raises(DatasetError, match=r"a\.mp4: not readable as a video"):
        count_frames(tmp_path / "a.mp4")
    encode(tmp_path / "b.mp4", 4)
    assert count_frames(tmp_path / "b.mp4") == 4
    joiner = VideoJoiner(tmp_path / "c.mp4", FPS)
    with pytest.raises(DatasetError, match="expected 3 pictures from 2 on, found 2"):
        joiner.append(tmp_path / "b.mp4", 2, 3)
