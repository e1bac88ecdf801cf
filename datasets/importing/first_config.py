"""A first `import.yaml` from what a recording holds: a guess to start from, told as one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from codediffuser.datasets.importing.config import ImportConfig
from codediffuser.datasets.importing.row_guesses import guess_rows
from codediffuser.datasets.importing.survey import Survey, TopicSurvey
from codediffuser.datasets.importing.values import joints_of, transforms_of
from codediffuser.files import write_text
from codediffuser.schema import dump_yaml

_COMMAND = ("command", "cmd", "target", "desired", "goal", "action", "leader", "setpoint")
_HAND = ("ee", "eef", "tcp", "hand", "tool", "flange", "gripper")
_GRIPPER = ("finger", "gripper")
_CAMERA_NOISE = frozenset((
    "color", "colour", "rgb", "depth", "image", "image_raw", "image_rect", "image_rect_color",
    "image_color", "raw", "rect", "compressed", "compresseddepth", "camera_info", "info", "points",
    "aligned_depth_to_color", "video", "h264",
))  # fmt: skip
"""Words in topics that say what a camera gives, not which it is."""
DEFAULT_HZ = 25

_HEADER = """# A first guess by `codediffuser import --inspect`: look through it before you import.
# What it could not tell is left out or set to the default. All keys: docs/importing.md
"""


def write_first_config(survey: Survey, path: Path, task: str) -> Path:
    """Write the guess for a recording, with a header that says so."""
    write_text(path, _HEADER + dump_yaml(guess_config(survey, task)))
    return path


def guess_config(survey: Survey, task: str) -> dict[str, Any]:
    """Guess the entries of an `import.yaml`.

    The guess may be incomplete: `ImportConfig` then says what is missing.
    """
    guess: dict[str, Any] = {"schema": ImportConfig.schema_name(), "task": task, "source": "real"}
    guess |= guess_rows(survey) if survey.hz else _guess_bag(survey)
    guess.setdefault("instruction", "")
    return guess


def _guess_bag(survey: Survey) -> dict[str, Any]:
    cameras = _cameras(survey)
    rates = [t.rate_hz for t in survey.of_role("color") if t.rate_hz]
    texts = [t.name for t in survey.of_role("text")]
    guess: dict[str, Any] = {
        "hz": max(1, round(min(rates))) if rates else DEFAULT_HZ,
        "instruction_topic": next(
            (t for t in texts if any(w in t.lower() for w in ("instruction", "lang", "task"))), ""
        ),
        "sync": {"clock": "bag", "max_age_s": 0.1, "on_stale": "drop"},
        "cameras": cameras,
    }
    frames = _frames(survey)
    guess["world_frame"] = next((f for f in ("world", "map", "base_link") if f in frames), "world")
    guess |= _motion(survey, frames)
    guess["episodes"] = _episodes(survey)
    return guess


def _cameras(survey: Survey) -> dict[str, Any]:
    depth = {camera_name(t.name): t.name for t in survey.of_role("depth")}
    infos: dict[str, list[str]] = {}
    for topic in survey.of_role("calibration"):
        infos.setdefault(camera_name(topic.name), []).append(topic.name)
    cameras: dict[str, Any] = {}
    for topic in survey.of_role("color"):
        name = camera_name(topic.name)
        if name in cameras:
            continue
        cameras[name] = {"color": topic.name}
        if name in depth:
            cameras[name]["depth"] = depth[name]
        if name in infos:
            cameras[name]["info"] = max(infos[name], key=lambda i: _shared(i, topic.name))
    return cameras


def camera_name(topic: str) -> str:
    """Name of a camera from one of its topics: `/camera/front/color/compressed` gives `front`."""
    words = [w for w in topic.strip("/").split("/") if w.lower() not in _CAMERA_NOISE]
    if len(words) > 1 and words[0] in ("camera", "cameras", "sensors"):
        words = words[1:]
    return "_".join(words) or "camera"


def _shared(a: str, b: str) -> int:
    return next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), len(a))


def _frames(survey: Survey) -> list[str]:
    """Frames that the first message of each topic of transforms names."""
    names: list[str] = []
    for topic in survey.of_role("transforms"):
        if topic.first is not None:
            for parent, child, _, _ in transforms_of(topic.first):
                names += [parent, child]
    return list(dict.fromkeys(names))


def _motion(survey: Survey, frames: list[str]) -> dict[str, Any]:
    """State and action."""
    joints, commanded_joints = _split(survey.of_role("joints"))
    poses, commanded_poses = _split(survey.of_role("pose"))
    numbers, commanded_numbers = _split(survey.of_role("number"))
    state: dict[str, Any] = {}
    if joints:
        state["joints"] = {"topic": joints[0].name}
    hand = _hand_source(poses, frames)
    gripper = _gripper_source(joints, numbers)
    if hand and gripper:
        state |= {"hand": hand, "gripper": gripper}
        commanded = _gripper_source(commanded_joints, commanded_numbers)
        if commanded_poses and commanded:
            pose = _best(commanded_poses)
            action = {"from": "command", "hand": {"topic": pose.name}, "gripper": commanded}
            return {"state": state, "action": action}
    elif commanded_joints:
        action = {"from": "command", "joints": {"topic": commanded_joints[0].name}}
        return {"state": state, "action": action}
    return {"state": state, "action": {"from": "next_state"}}


def _split(topics: list[TopicSurvey]) -> tuple[list[TopicSurvey], list[TopicSurvey]]:
    """Those that are measured, and those that are commanded."""
    commanded = [t for t in topics if any(word in t.name.lower() for word in _COMMAND)]
    return [t for t in topics if t not in commanded], commanded


def _best(poses: list[TopicSurvey]) -> TopicSurvey:
    return next((p for p in poses if any(w in p.name.lower() for w in _HAND)), poses[0])


def _hand_source(poses: list[TopicSurvey], frames: list[str]) -> dict[str, str] | None:
    if poses:
        return {"topic": _best(poses).name}
    named = (f for f in frames if any(w in f.lower().split("_") for w in _HAND[:5]))
    frame = next(named, None)
    return None if frame is None else {"frame": frame}


def _gripper_source(joints: list[TopicSurvey], numbers: list[TopicSurvey]) -> dict[str, Any] | None:
    for topic in joints:
        if topic.first is not None:
            names = [n for n in joints_of(topic.first, topic.name)[0] if _is_gripper(n)]
            if names:
                return {"topic": topic.name, "joints": names}
    named = [t.name for t in numbers if _is_gripper(t.name)]
    return {"topic": named[0]} if named else None


def _is_gripper(name: str) -> bool:
    return any(word in name.lower() for word in _GRIPPER)


def _episodes(survey: Survey) -> dict[str, Any]:
    """Markers when there are topics of them; else the whole bag."""
    markers = []
    for topic in survey.of_role("marker"):
        name = topic.name.lower()
        if any(word in name for word in ("stop", "end", "done")):
            markers.append({"topic": topic.name, "means": "stop"})
        elif any(word in name for word in ("start", "begin")):
            markers.append({"topic": topic.name, "means": "start"})
        elif topic.type.endswith("String"):
            markers += [
                {"topic": topic.name, "value": word, "means": word}
                for word in ("start", "stop", "success", "failure", "discard")
            ]
    if any(marker["means"] == "start" for marker in markers):
        return {"by": "markers", "markers": markers}
    return {"by": "whole"}
