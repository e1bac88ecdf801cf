"""Videos: every picture arrives, joined and cut files hold the same packets."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest
from pydantic import ValidationError

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


def test_quality_is_the_codecs_own_unless_chosen() -> None:
    assert [VideoConfig(codec=c).crf for c in ("av1", "h264", "hevc")] == [30, 17, 21]
    assert VideoConfig().crf == 30
    assert VideoConfig(codec="h264", crf=40).crf == 40
    assert VideoConfig.model_validate({"codec": "hevc", "crf": None}) == VideoConfig(codec="hevc")


def test_a_quality_that_the_codec_has_not_is_an_error() -> None:
    assert VideoConfig(crf=63).crf == 63
    with pytest.raises(ValidationError, match="h264 has qualities from 0 to 51, got 60"):
        VideoConfig(codec="h264", crf=60)


@pytest.mark.parametrize("codec", ["h264", "hevc"])
def test_other_codecs_come_as_near_to_the_pictures_as_av1(codec: Codec, tmp_path: Path) -> None:
    errors = {name: _error(name, tmp_path / f"{name}.mp4") for name in ("av1", codec)}
    assert errors[codec] < 1.1 * errors["av1"]


def _error(codec: Codec, path: Path) -> float:
    """Mean squared error of a drifting picture with edges, texture and shading."""
    y, x = np.mgrid[0:240, 0:400].astype(np.float64)
    shade = 120 + 60 * np.sin(x / 40) + 30 * np.cos(y / 17) + 20 * (np.hypot(x - 200, y - 120) < 50)
    texture = np.random.default_rng(0).normal(0, 2, shade.shape)
    picture = np.clip(np.stack([shade + texture, shade * 0.8, 255 - shade], -1), 0, 255)
    pictures = [picture[:, 4 * k : 4 * k + 320].astype(np.uint8) for k in range(8)]
    with VideoEncoder(path, VideoConfig(codec=codec), 320, 240, FPS) as encoder:
        for each in pictures:
            encoder.add(each)
    with av.open(str(path)) as container:
        found = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
    return float(np.mean((np.array(found, np.float64) - np.array(pictures)) ** 2))


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
