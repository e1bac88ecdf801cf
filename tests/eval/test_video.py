"""Facts about frames, videos and strips."""

import io

import numpy as np
import pytest
from PIL import Image

from codediffuser.errors import ShapeError
from codediffuser.eval.video import (
    ROLE_COLORS,
    Caption,
    VideoView,
    compose_frame,
    key_frame_strip,
    tint_attention,
)
from codediffuser.video import write_video

CAPTION = Caption("Put a battery outside the crate on a slot.", 1.0, "reach", ("a", "b"), False)
K = np.array([[50.0, 0, 19.5], [0, 50.0, 14.5], [0, 0, 1]])


def make_view(depth_m=0.0):
    return VideoView(
        rgb=np.full((30, 40, 3), 100, np.uint8),
        depth_m=np.full((30, 40), depth_m, np.float32),
        K=K,
        T_world_camera=np.eye(4),
    )


def picture(value):
    return np.full((120, 160, 3), value, np.uint8)


def test_video_reads_back_with_its_frames_and_rate(tmp_path):
    import av

    frames = [compose_frame([picture(v), picture(255 - v)], CAPTION) for v in (0, 120, 240)]
    assert write_video(iter(frames), tmp_path / "v.mp4", fps=6.25) == 3
    with av.open(str(tmp_path / "v.mp4")) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert float(stream.average_rate) == 6.25
        read = [f.to_ndarray(format="rgb24") for f in container.decode(stream)]
    assert [f.shape for f in read] == [(320, 640, 3)] * 3
    assert abs(int(read[1][100, 100, 0]) - 120) < 8


@pytest.mark.parametrize("frames", [[], [picture(0), picture(0)[:-2]], [picture(0)[:-1]]])
def test_video_that_cannot_be_leaves_no_file(tmp_path, frames):
    with pytest.raises(ShapeError):
        write_video(frames, tmp_path / "v.mp4", fps=5)
    assert list(tmp_path.iterdir()) == []


def test_attention_at_the_edge_of_a_picture_stays_inside():
    points = np.array([[-0.39, -0.29, 1.0]], np.float32)
    tinted = tint_attention(make_view(), points, np.ones((1, 2), np.float32))
    assert (tinted != 100).any(axis=2).sum() == 4


def test_attention_tints_the_pixel_a_point_falls_on():
    points = np.array([[0, 0, 1.0], [0.2, 0.1, 1.0]], np.float32)
    tinted = tint_attention(make_view(), points, np.array([[1, 0], [0, 1]], np.float32))
    changed = np.argwhere((tinted != 100).any(axis=2))
    # Columns 50 * x + 19.5 and rows 50 * y + 14.5, halves rounded to even, and their neighbours.
    near = [(np.abs(changed - pixel) <= 1).all(axis=1) for pixel in ([14, 20], [20, 30])]
    assert [int(n.sum()) for n in near] == [9, 9] and len(changed) == 18
    assert tinted[14, 20, 0] > tinted[14, 20, 2]
    assert ROLE_COLORS[1][1] > 150 and tinted[20, 30, 1] > tinted[20, 30, 0]


@pytest.mark.parametrize(
    "point, depth_m",
    [((0, 0, 1.0), 0.5), ((0, 0, -1.0), 0.0), ((9, 0, 1.0), 0.0)],
    ids=["hidden", "behind", "outside"],
)
def test_attention_leaves_pixels_of_points_that_are_not_seen(point, depth_m):
    view = make_view(depth_m)
    tinted = tint_attention(view, np.array([point], np.float32), np.ones((1, 2), np.float32))
    assert (tinted == view.rgb).all()


def test_attention_that_is_nothing_changes_nothing():
    tinted = tint_attention(make_view(), np.zeros((0, 3), np.float32), np.zeros((0, 2), np.float32))
    assert (tinted == 100).all()


def test_captions_of_any_length_keep_the_frame_even():
    long = Caption("word " * 80, 9.6, "carry", ("battery_0", "slot_11"), True)
    frame = compose_frame([picture(9)], long)
    assert frame.shape == (320, 320, 3)
    assert (frame[:240] == 9).all()


def test_frame_of_no_picture_is_refused():
    with pytest.raises(ShapeError, match="at least one picture"):
        compose_frame([], CAPTION)


@pytest.mark.parametrize("count", [1, 4, 30])
def test_strip_shows_first_and_last_of_any_number(count):
    strip = Image.open(io.BytesIO(key_frame_strip([picture(10 + 6 * i) for i in range(count)])))
    assert strip.size == (480, 240)
    pixels = np.asarray(strip)
    assert abs(int(pixels[60, 80, 0]) - 10) < 4
    assert abs(int(pixels[180, 400, 0]) - (10 + 6 * (count - 1))) < 4
