"""Pixels of every encoding, and videos frame by frame."""

import struct
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from codediffuser.datagen.episode_format import ImageOptions
from codediffuser.datasets.importing.pictures import color_of, depth_mm_of, to_millimetres
from codediffuser.datasets.importing.stored_pictures import stored_picture
from codediffuser.datasets.importing.video import VideoReader, is_key_packet, video_codec
from codediffuser.errors import DatasetError

RGB = np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8)
DEPTH = np.arange(48, dtype=np.uint16).reshape(6, 8) * 100


def raw(pixels, encoding, *, pad=0, bigendian=0):
    rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, pad)))
    return SimpleNamespace(
        height=pixels.shape[0], width=pixels.shape[1], encoding=encoding, step=rows.shape[1],
        is_bigendian=bigendian, data=rows.reshape(-1),
    )  # fmt: skip


def packed(data, picture_format):
    return SimpleNamespace(data=np.frombuffer(data, np.uint8), format=picture_format)


@pytest.mark.parametrize(
    ("pixels", "encoding"),
    [
        (RGB, "rgb8"),
        (RGB[..., ::-1], "bgr8"),
        (np.dstack([RGB, RGB[..., :1]]), "rgba8"),
        (np.dstack([RGB[..., ::-1], RGB[..., :1]]), "BGRA8"),
    ],
)
@pytest.mark.parametrize("pad", [0, 5])
def test_raw_colour_comes_out_as_rgb(pixels, encoding, pad):
    assert np.array_equal(color_of(raw(pixels, encoding, pad=pad), "/t"), RGB)


def test_gray_has_three_equal_channels():
    gray = color_of(raw(RGB[..., 0], "mono8"), "/t")
    assert np.array_equal(gray, np.repeat(RGB[..., :1], 3, axis=2))


def test_bayer_finds_the_colours():
    red = np.zeros((8, 8), np.uint8)
    red[0::2, 0::2] = 255
    middle = color_of(raw(red, "bayer_rggb8"), "/t")[3:5, 3:5].reshape(-1, 3).mean(0)
    assert middle[0] > 200 and middle[1] < 50 and middle[2] < 50


def test_png_is_exact_and_an_unknown_encoding_is_named():
    _, data = cv2.imencode(".png", RGB[..., ::-1])
    assert np.array_equal(color_of(packed(data.tobytes(), "rgb8; png compressed bgr8"), "/t"), RGB)
    with pytest.raises(DatasetError, match=r"'/t'.*'rgb48'"):
        color_of(raw(RGB, "rgb48"), "/t")
    with pytest.raises(DatasetError, match="damaged"):
        color_of(packed(b"no picture", "jpeg"), "/t")


@pytest.mark.parametrize("bigendian", [0, 1])
def test_integer_depth_is_exact(bigendian):
    stored = DEPTH.byteswap() if bigendian else DEPTH
    assert np.array_equal(depth_mm_of(raw(stored, "16UC1", bigendian=bigendian), "/t", None), DEPTH)
    half = depth_mm_of(raw(stored, "16UC1", bigendian=bigendian), "/t", 0.0005)
    assert np.array_equal(half, np.rint(DEPTH / 2))


def test_float_depth_is_rounded_and_bad_readings_are_0():
    metres = (DEPTH / 1000).astype(np.float32)
    metres[0, :4] = np.nan, np.inf, -1, 70
    found = depth_mm_of(raw(metres, "32FC1"), "/t", None)
    assert found[0, :4].tolist() == [0, 0, 0, 0]
    assert np.array_equal(found[1:], DEPTH[1:])


def test_compressed_depth_of_integers_and_of_floats():
    _, png = cv2.imencode(".png", DEPTH)
    message = packed(struct.pack("<iff", 0, 3e38, -2.0) + png.tobytes(), "16UC1; compressedDepth")
    assert np.array_equal(depth_mm_of(message, "/t", None), DEPTH)
    # The packer's arithmetic for floats: quantisation 100, greatest depth 10 m.
    a, metres = 100 * 101.0, np.linspace(0.5, 9, 48).reshape(6, 8)
    b = 1 - a / 10
    _, png = cv2.imencode(".png", (a / metres + b).astype(np.uint16))
    message = packed(struct.pack("<iff", 0, a, b) + png.tobytes(), "32FC1; compressedDepth png")
    assert np.abs(depth_mm_of(message, "/t", None) - metres * 1000).max() < 10


def test_millimetres_are_not_copied():
    assert to_millimetres(DEPTH, None) is DEPTH


@pytest.mark.parametrize(("suffix", "kind"), [(".jpg", "jpeg"), (".png", "png")])
def test_a_compressed_picture_is_kept_with_its_size(suffix, kind):
    data = cv2.imencode(suffix, RGB)[1].tobytes()
    kept = stored_picture(data + bytes(7), ImageOptions(format=kind))
    assert kept is not None and (kept.data, kept.shape) == (data, RGB.shape)
    other = "png" if kind == "jpeg" else "jpeg"
    assert stored_picture(data, ImageOptions(format=other)) is None
    assert stored_picture(data[:-4], ImageOptions(format=kind)) is None
    gray = cv2.imencode(suffix, RGB[..., 0])[1].tobytes()
    assert stored_picture(gray, ImageOptions(format=kind)) is None


@pytest.fixture(scope="module")
def h264_packets():
    """Sixty pictures that get brighter, a key frame every twenty, one packet each."""
    import av

    encoder = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height, encoder.pix_fmt = 64, 48, "yuv420p"
    encoder.framerate, encoder.gop_size, encoder.max_b_frames = 30, 20, 0
    encoder.options = {"preset": "ultrafast", "tune": "zerolatency", "crf": "5"}
    packets = []
    for k in range(60):
        frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 4 * k, np.uint8), format="rgb24")
        packets += [bytes(p) for p in encoder.encode(frame)]
    return packets + [bytes(p) for p in encoder.encode(None)]


def test_video_gives_the_picture_of_each_packet_in_any_order(h264_packets):
    assert len(h264_packets) == 60
    assert [k for k, p in enumerate(h264_packets) if is_key_packet(p, "h264")] == [0, 20, 40]
    reader = VideoReader(h264_packets.__getitem__, "h264", "/video")
    for k in (0, 1, 5, 30, 59, 3, 45):
        picture = reader.picture(k)
        assert picture.shape == (48, 64, 3)
        assert abs(float(picture.mean()) - 4 * k) < 4


def test_a_video_without_a_key_frame_is_refused(h264_packets):
    with pytest.raises(DatasetError, match="no key frame comes before packet 3"):
        VideoReader(h264_packets[1:].__getitem__, "h264", "/video").picture(3)


def test_the_codec_is_told_from_the_format():
    assert video_codec(SimpleNamespace(format="h264")) == "h264"
    assert video_codec(SimpleNamespace(format="jpeg")) is None
