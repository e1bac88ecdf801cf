"""Foxglove's own schemas, in protobuf and in JSON, and messages that only the bag defines."""

import base64
import json

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from codediffuser.datagen.episode import Episode, list_episodes
from codediffuser.datasets.importing.config import ImportConfig
from codediffuser.datasets.importing.decoding import Decoder
from codediffuser.datasets.importing.first_config import guess_config
from codediffuser.datasets.importing.recording import Topic
from codediffuser.datasets.importing.survey import survey_source
from codediffuser.datasets.importing.values import calibration_of, joints_of, pose_of, text_of
from codediffuser.errors import DatasetError

START_S = 1_700_000_000
H, W = 24, 32


def descriptor_set(message_class):
    """A message's file with all that it imports, as MCAP stores it."""
    found = FileDescriptorSet()
    seen = set()

    def add(file):
        for needed in file.dependencies:
            add(needed)
        if file.name not in seen:
            seen.add(file.name)
            file.CopyToProto(found.file.add())

    add(message_class.DESCRIPTOR.file)
    return found.SerializeToString()


def color(k):
    return np.full((H, W, 3), (10 * k, 50, 200), np.uint8)


def protobuf_messages(k, t):
    """Topic and message at a moment."""
    image = CompressedImage(format="png", frame_id="optical")
    image.data = cv2.imencode(".png", color(k)[..., ::-1])[1].tobytes()
    depth = RawImage(width=W, height=H, encoding="16UC1", step=2 * W, frame_id="optical")
    depth.data = np.full((H, W), 700 + k, "<u2").tobytes()
    info = CameraCalibration(width=W, height=H, frame_id="optical")
    info.K.extend([30, 0, 15.5, 0, 30, 11.5, 0, 0, 1])
    tf = FrameTransform(parent_frame_id="world", child_frame_id="optical")
    tf.translation.z, tf.rotation.x = 1.0, 1.0
    hand = PoseInFrame(frame_id="world")
    hand.pose.position.x, hand.pose.orientation.w = 0.01 * k, 1.0
    messages = {"/cam/image": image, "/cam/depth": depth, "/cam/info": info, "/tf_static": tf,
                "/ee_pose": hand}  # fmt: skip
    for message in messages.values():
        message.timestamp.FromNanoseconds(t)
    return messages


def write_protobuf(path, count=10):
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channels = {}
        for k in range(count):
            t = START_S * 10**9 + k * 100_000_000
            for topic, message in protobuf_messages(k, t).items():
                if topic not in channels:
                    name = message.DESCRIPTOR.full_name
                    schema = writer.register_schema(name, "protobuf", descriptor_set(type(message)))
                    channels[topic] = writer.register_channel(topic, "protobuf", schema)
                writer.add_message(channels[topic], t, message.SerializeToString(), t)
            opening = json.dumps({"timestamp": {"sec": START_S, "nsec": k + 1}, "value": 0.03})
            if "/gripper" not in channels:
                channels["/gripper"] = writer.register_channel("/gripper", "json", 0)
            writer.add_message(channels["/gripper"], t, opening.encode(), t)
        writer.finish()


def test_foxglove_protobuf_and_json_become_an_episode(tmp_path, run_import):
    write_protobuf(tmp_path / "foxglove.mcap")
    guess = guess_config(survey_source(tmp_path / "foxglove.mcap"), "pack_battery")
    assert guess["cameras"] == {
        "cam": {"color": "/cam/image", "depth": "/cam/depth", "info": "/cam/info"}
    }
    assert guess["world_frame"] == "world" and guess["hz"] == 10
    guess["state"] = {"hand": {"topic": "/ee_pose"}, "gripper": {"topic": "/gripper"}}
    guess |= {"instruction": "Go.", "image": {"format": "png"}}
    run, (result,) = run_import(tmp_path / "foxglove.mcap", ImportConfig.parse(guess, "guess"))
    assert result.outcome == "imported", result.reason
    episode = Episode.open(list_episodes(run)[0])
    assert episode.num_frames == 9
    assert np.allclose(episode.state[:, 0], 0.01 * np.arange(9)) and episode.state[0, 9] > 0.029
    frame = episode.frame(4)
    assert np.array_equal(frame.rgb["cam"], color(4))
    assert np.allclose(frame.depth_m["cam"], 0.704)
    assert np.allclose(episode.cameras["cam"].T_world_camera[:3, 2], [0, 0, -1])


def test_a_recorded_video_gives_a_picture_for_every_frame(tmp_path, run_import):
    import av

    encoder = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height, encoder.pix_fmt = 64, 48, "yuv420p"
    encoder.framerate, encoder.gop_size, encoder.max_b_frames = 10, 8, 0
    encoder.options = {"preset": "ultrafast", "tune": "zerolatency", "crf": "5"}
    with (tmp_path / "video.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(
            "foxglove.CompressedVideo", "protobuf", descriptor_set(CompressedVideo)
        )
        video = writer.register_channel("/cam/video", "protobuf", schema)
        joints = writer.register_channel("/joints", "json", 0)
        for k in range(20):
            t = START_S * 10**9 + k * 100_000_000
            pixels = np.full((48, 64, 3), 12 * k, np.uint8)
            (packet,) = encoder.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24"))
            message = CompressedVideo(frame_id="cam", data=bytes(packet), format="h264")
            message.timestamp.FromNanoseconds(t)
            writer.add_message(video, t, message.SerializeToString(), t)
            state = json.dumps({"name": ["a"], "position": [k]})
            writer.add_message(joints, t, state.encode(), t)
        writer.finish()
    numbers = {"topic": "/joints"}
    config = {
        "schema": "codediffuser.import/1", "task": "pack_battery", "hz": 5, "instruction": "Go.",
        "cameras": {"cam": {"color": "/cam/video"}}, "state": {"joints": numbers},
        "action": {"from": "next_state"}, "image": {"format": "png"},
        # The first half has its key frame before the start of the episode.
        "episodes": {"by": "times", "times_s": [[0.4, 1.9]]},
    }  # fmt: skip
    run, (result,) = run_import(tmp_path / "video.mcap", ImportConfig.parse(config, "test"))
    assert result.outcome == "imported", result.reason
    episode = Episode.open(list_episodes(run)[0])
    assert episode.state[:, 0].tolist() == [4, 6, 8, 10, 12, 14, 16]
    means = [frame.rgb["cam"].mean() for frame in episode.frames()]
    assert np.abs(np.array(means) - 12 * episode.state[:, 0]).max() < 6


def decoder(encoding, type_name="x", schema_encoding="", schema=b""):
    return Decoder(Topic("/t", type_name, encoding, schema_encoding, schema))


def test_json_carries_pictures_in_base_64():
    from codediffuser.datasets.importing.pictures import color_of

    data = cv2.imencode(".png", color(3)[..., ::-1])[1].tobytes()
    raw = json.dumps({"format": "png", "data": base64.b64encode(data).decode()}).encode()
    assert np.array_equal(color_of(decoder("json").decode(raw), "/t"), color(3))


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_a_message_that_only_the_bag_defines_is_read(encoding):
    store = get_typestore(Stores.ROS2_HUMBLE if encoding == "cdr" else Stores.ROS1_NOETIC)
    text = "std_msgs/Header header\nfloat64 data\nlab_msgs/Extra[] extra\n" + "=" * 80
    text += "\nMSG: lab_msgs/Extra\nstring note\n"
    types = get_types_from_msg(text, "lab_msgs/msg/Gripper")
    store.register({k: v for k, v in types.items() if k.startswith("lab_msgs")})
    stamp = store.types["builtin_interfaces/msg/Time"](START_S, 7)
    first = () if encoding == "cdr" else (1,)
    header = store.types["std_msgs/msg/Header"](*first, stamp, "")
    extra = [store.types["lab_msgs/msg/Extra"]("a"), store.types["lab_msgs/msg/Extra"]("b")]
    message = store.types["lab_msgs/msg/Gripper"](header, 0.25, extra)
    write = store.serialize_cdr if encoding == "cdr" else store.serialize_ros1
    data = bytes(write(message, "lab_msgs/msg/Gripper"))
    definition, _ = store.generate_msgdef("lab_msgs/msg/Gripper", ros_version=2 - len(first))
    schema_encoding = "ros2msg" if encoding == "cdr" else "ros1msg"
    read = decoder(encoding, "lab_msgs/msg/Gripper", schema_encoding, definition.encode())
    assert read.stamp_ns(data) == START_S * 10**9 + 7
    assert joints_of(read.decode(data), "/t")[1].tolist() == [0.25]
    assert read.decode(data).extra[1].note == "b"
    with pytest.raises(DatasetError, match=r"'/t': a message is no lab_msgs/msg/Gripper"):
        read.decode(data[:9])


def test_a_type_that_nobody_defines_is_named():
    with pytest.raises(DatasetError, match="brings no definition of lab_msgs/msg/Unknown"):
        decoder("cdr", "lab_msgs/msg/Unknown")


def test_of_a_services_events_only_received_requests_count():
    def event(kind, request):
        raw = json.dumps({"info": {"event_type": kind}, "request": request, "response": []})
        return text_of(decoder("json").decode(raw.encode()))

    assert event(1, [{"data": True}]) == "true"
    assert event(1, []) == ""
    assert event(0, [{"data": True}]) is None and event(2, []) is None


def test_values_that_are_missing_are_told():
    message = decoder("json").decode(b'{"speed": 3}')
    with pytest.raises(DatasetError, match="expected poses, got messages with the fields speed"):
        pose_of(message, "/t")
    blank = decoder("json").decode(json.dumps({"K": [0] * 9, "width": 1, "height": 1}).encode())
    with pytest.raises(DatasetError, match="never calibrated"):
        calibration_of(blank, "/t")
