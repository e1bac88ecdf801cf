"""What --inspect tells, and the first import.yaml that it writes."""

import pytest

from codediffuser.cli import run as command
from codediffuser.datasets.importing.config import ImportConfig
from codediffuser.datasets.importing.first_config import camera_name, guess_config
from codediffuser.datasets.importing.survey import survey_source
from codediffuser.errors import ConfigError
from codediffuser.verbs.verb import console


def test_the_survey_gives_types_rates_gaps_and_roles(tmp_path, bag):
    bag.drop("/cam/image", *range(20, 30))
    bag.mark(0.5, "start")
    survey = survey_source(bag.write_rosbag2(tmp_path / "bag"))
    topics = {t.name: t for t in survey.topics}
    image = topics["/cam/image"]
    assert (image.type, image.role, image.count) == ("sensor_msgs/msg/Image", "color", 50)
    assert image.rate_hz == pytest.approx(30) and image.gaps == 1
    assert image.longest_gap_s == pytest.approx(11 / 30)
    roles = {name: topic.role for name, topic in topics.items()}
    assert roles["/cam/depth"] == "depth" and roles["/cam/info"] == "calibration"
    assert roles["/tf_static"] == "transforms" and roles["/joint_states"] == "joints"
    assert roles["/episode"] == "marker" and roles["/ee_pose"] == "pose"


def test_the_first_guess_finds_cameras_state_action_and_markers(tmp_path, bag):
    bag.mark(0.5, "start")
    guess = guess_config(survey_source(bag.write_rosbag2(tmp_path / "bag")), "pack_battery")
    config = ImportConfig.parse(guess, "guess")
    assert config.cameras["cam"].depth == "/cam/depth" and config.cameras["cam"].info == "/cam/info"
    assert config.hz == 30 and config.world_frame == "world"
    assert config.state.hand.topic == "/ee_pose"
    assert config.state.gripper.joints == ("finger_left", "finger_right")
    # The command brings no opening, so what was reached is the target.
    assert config.action.origin == "next_state"
    assert config.episodes.by == "markers"


@pytest.mark.parametrize(
    ("topic", "name"),
    [
        ("/camera/front/color/compressed", "front"),
        ("/camera/color/image_raw", "camera"),
        ("/wrist_cam/aligned_depth_to_color/image_raw", "wrist_cam"),
        ("/left/realsense/rgb/image_rect_color", "left_realsense"),
    ],
)
def test_cameras_are_named_after_what_differs(topic, name):
    assert camera_name(topic) == name


def test_the_command_inspects_and_imports(tmp_path, bag, capsys, monkeypatch):
    path = bag.write_rosbag2(tmp_path / "bag")
    config, out = tmp_path / "import.yaml", tmp_path / "run"
    assert command(["import", str(path), "--inspect", "--config", str(config)]) == 0
    captured = capsys.readouterr()
    assert captured.out.strip() == str(config) and "/cam/depth" in captured.err
    assert config.read_text().startswith("# A first guess")
    assert command(["import", str(path), "--inspect", "--config", str(config)]) == 2
    assert "is there already and was not touched" in " ".join(capsys.readouterr().err.split())
    arguments = ["import", str(path), "--config", str(config), "--out", str(out)]
    # Nobody has said yet what was asked.
    assert command(arguments) == 3
    config.write_text(config.read_text().replace("instruction: ''", "instruction: Go.")
                      .replace('instruction: ""', "instruction: Go."))  # fmt: skip
    assert command(arguments) == 0
    assert capsys.readouterr().out.strip().splitlines()[-1] == str(out)
    assert (out / "episodes/000000/episode.json").is_file()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"camera": {}}, "unknown key 'camera'; did you mean 'cameras'"),
        ({"action": {"from": "command"}}, "actions of a hand state need hand and gripper"),
        ({"state": {"hand": {"topic": "/a"}}}, "hand and gripper belong together"),
        ({"episodes": {"by": "markers"}}, "needs a marker that means start"),
        ({"sync": {"clock": "wall"}}, "key 'sync.clock'"),
    ],
)
def test_mistakes_in_the_configuration_are_named(changes, message, make_config):
    with pytest.raises(ConfigError, match=message):
        make_config(**changes)


def test_a_table_in_a_file_keeps_every_name_and_number(bag, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(console, "width", 60)
    source, config = bag.write_rosbag2(tmp_path / "bag"), tmp_path / "import.yaml"
    assert command(["import", str(source), "--inspect", "--config", str(config)]) == 0
    (line,) = (x for x in capsys.readouterr().err.splitlines() if x.startswith("/cam/depth"))
    assert line.split() == ["/cam/depth", "sensor_msgs/msg/Image", "depth", "60", "30.0"]
