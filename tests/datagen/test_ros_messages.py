"""Each message reads back as what was written, and is what ROS tools expect."""

import numpy as np
import pytest
from mcap_ros2.decoder import DecoderFactory

from codediffuser.datagen import ros_messages as ros
from codediffuser.datagen.episode_format import Camera, ImageOptions
from codediffuser.errors import EpisodeError, ShapeError
from codediffuser.poses import pose_to_transform


def smooth_rgb():
    rows, columns = np.mgrid[:24, :32]
    return np.stack([rows * 8, columns * 7, rows + columns], axis=-1).astype(np.uint8)


def test_png_colour_comes_back_exactly():
    rgb = smooth_rgb()
    data = ros.encode_color(rgb, 0, "left_optical", ImageOptions(format="png"))
    np.testing.assert_array_equal(ros.decode_color(data), rgb)


def test_jpeg_colour_comes_back_nearly_and_in_rgb_order():
    rgb = np.zeros((16, 16, 3), np.uint8)
    rgb[..., 0] = 200
    back = ros.decode_color(ros.encode_color(rgb, 0, "left_optical"))
    assert np.abs(back.astype(int) - rgb).max() < 8


def test_depth_comes_back_exactly_over_the_whole_range():
    depth_mm = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    np.testing.assert_array_equal(
        ros.decode_depth(ros.encode_depth(depth_mm, 0, "left_optical")), depth_mm
    )


def test_depth_of_a_strided_view_comes_back_exactly():
    depth_mm = np.arange(64, dtype=np.uint16).reshape(8, 8)[::2, ::-1]
    np.testing.assert_array_equal(
        ros.decode_depth(ros.encode_depth(depth_mm, 0, "left_optical")), depth_mm
    )


def test_poses_come_back_and_stamps_split_into_seconds():
    T = pose_to_transform(np.array([0.1, -0.2, 0.3]), np.array([0.1, 0.7, -0.2, 0.4]))
    data = ros.encode_pose(T, 3_040_000_000)
    np.testing.assert_allclose(ros.decode_pose(data), T, atol=1e-12)
    message = ros._decode(data, ros.POSE_STAMPED)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 40_000_000)
    assert message.header.frame_id == "world"


def test_ros_quaternion_order_is_xyzw():
    half_turn_about_z = pose_to_transform(np.zeros(3), np.array([0.0, 0, 0, 1]))
    q = ros._decode(ros.encode_pose(half_turn_about_z, 0), ros.POSE_STAMPED).pose.orientation
    np.testing.assert_allclose([q.x, q.y, q.z, q.w], [0, 0, 1, 0], atol=1e-12)


def test_camera_info_and_static_transforms_come_back():
    K = np.array([[100.0, 0, 15.5], [0, 101.0, 11.5], [0, 0, 1]])
    T = pose_to_transform(np.array([0.5, 0.5, 0.6]), np.array([0.3, -0.5, 0.7, 0.1]))
    K_back, width, height = ros.decode_camera_info(
        ros.encode_camera_info(Camera(K, T, 32, 24), "left_optical")
    )
    np.testing.assert_array_equal(K_back, K)
    assert (width, height) == (32, 24)
    back = ros.decode_transforms(ros.encode_transforms({"left_optical": T}))
    np.testing.assert_allclose(back["left_optical"], T, atol=1e-12)


def test_joints_text_and_numbers_come_back():
    names, qpos, qvel = ros.decode_joint_state(
        ros.encode_joint_state(("a", "b"), np.array([0.1, 0.2]), np.array([1.0, 2.0]), 5)
    )
    assert names == ("a", "b")
    np.testing.assert_array_equal(qpos, [0.1, 0.2])
    np.testing.assert_array_equal(qvel, [1.0, 2.0])
    assert ros.decode_string(ros.encode_string("Röd mugg")) == "Röd mugg"
    assert ros.decode_float(ros.encode_float(0.04)) == 0.04


@pytest.mark.parametrize(
    ("type_name", "data"),
    [
        (ros.COMPRESSED_IMAGE, ros.encode_color(smooth_rgb(), 7, "left_optical")),
        (ros.IMAGE, ros.encode_depth(np.ones((4, 6), np.uint16), 7, "left_optical")),
        (ros.JOINT_STATE, ros.encode_joint_state(("a",), np.ones(1), np.ones(1), 7)),
        (ros.TF_MESSAGE, ros.encode_transforms({"left_optical": np.eye(4)})),
        (ros.FLOAT64, ros.encode_float(1.5)),
    ],
)
def test_another_decoder_reads_our_bytes_by_our_definition(type_name, data):
    from mcap.records import Schema

    schema = Schema(id=1, name=type_name, encoding="ros2msg", data=ros.definition(type_name))
    decoded = DecoderFactory().decoder_for("cdr", schema)(data)
    if type_name == ros.IMAGE:
        assert (decoded.height, decoded.width, decoded.encoding) == (4, 6, "16UC1")
    if type_name == ros.FLOAT64:
        assert decoded.data == 1.5


def test_colour_of_a_wrong_dtype_is_refused():
    with pytest.raises(ShapeError, match=r"rgb of left_optical: expected \(H, W, 3\) uint8"):
        ros.encode_color(np.zeros((4, 4, 3), np.float32), 0, "left_optical")


def test_depth_in_metres_is_refused():
    with pytest.raises(ShapeError, match=r"depth of left_optical: expected \(H, W\) uint16"):
        ros.encode_depth(np.ones((4, 4), np.float32), 0, "left_optical")


def test_a_joint_without_a_name_is_refused():
    with pytest.raises(ShapeError, match="expected 1 joints"):
        ros.encode_joint_state(("a",), np.ones(2), np.ones(2), 0)


def test_a_picture_of_damaged_bytes_is_refused():
    message = ros._TYPES[ros.COMPRESSED_IMAGE](
        ros._header(0, ""), "jpeg", np.arange(9, dtype=np.uint8)
    )
    with pytest.raises(EpisodeError, match="'jpeg' cannot be decompressed"):
        ros.decode_color(ros._encode(message, ros.COMPRESSED_IMAGE))


def test_a_transform_from_another_frame_is_refused():
    data = bytearray(ros.encode_transforms({"left_optical": np.eye(4)}))
    at = bytes(data).index(b"world")
    data[at : at + 5] = b"table"
    with pytest.raises(EpisodeError, match="expected 'left_optical' in frame 'world', got 'table'"):
        ros.decode_transforms(bytes(data))
