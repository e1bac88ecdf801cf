"""Guesses for formats with one row per frame, by the names that their owners use."""

from __future__ import annotations

from typing import Any

from codediffuser.datagen.trajectory import ACTION_NAMES
from codediffuser.datasets.importing.survey import Survey

_ALOHA_ARM = ("waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate",
              "gripper")  # fmt: skip
_ALOHA_PICTURES, _ROBOMIMIC_OBS = "observations/images/", "obs/"


def guess_rows(survey: Survey) -> dict[str, Any]:
    """Rate, cameras, state and action for a file of rows."""
    paths = {topic.name: topic for topic in survey.topics}
    guess = {
        "aloha": _aloha,
        "robomimic": _robomimic,
        "maniskill": _maniskill,
        "zarr": _zarr,
    }[survey.format](survey, paths)
    return {"hz": survey.hz, **(guess | _hand_rows(paths))}


def _hand_rows(paths: dict[str, Any]) -> dict[str, Any]:
    """State and action where both are rows of hand pose and opening, as our exports have them."""
    state = next((n for n in ("observations/state", "obs/state", "state") if n in paths), "")
    action = next((n for n in ("action", "actions") if n in paths), "")
    rows = len(ACTION_NAMES)
    if not _width(paths, state) == _width(paths, action) == rows:
        return {}

    def parts(topic: str) -> dict[str, Any]:
        hand = {"topic": topic, "columns": [0, rows - 1], "layout": "xyz_rot6d"}
        return {"hand": hand, "gripper": {"topic": topic, "columns": [rows - 1, rows]}}

    return {"state": parts(state), "action": {"from": "command", **parts(action)}}


def _aloha(survey: Survey, paths: dict[str, Any]) -> dict[str, Any]:
    folder = _ALOHA_PICTURES
    cameras = {t.name.removeprefix(folder): {"color": t.name} for t in survey.of_role("color")}
    for name, camera in cameras.items():
        if f"observations/depth/{name}" in paths:
            camera["depth"] = f"observations/depth/{name}"
    joints: dict[str, Any] = {"topic": "observations/qpos"}
    command: dict[str, Any] = {"topic": "action"}
    if _width(paths, "observations/qpos") == 2 * len(_ALOHA_ARM) == _width(paths, "action"):
        names = [f"{side}_{joint}" for side in ("left", "right") for joint in _ALOHA_ARM]
        joints["joints"] = command["joints"] = names
    return {
        "cameras": cameras,
        "state": {"joints": joints},
        "action": {"from": "command", "joints": command},
    }


def _robomimic(survey: Survey, paths: dict[str, Any]) -> dict[str, Any]:
    folder = _ROBOMIMIC_OBS
    cameras: dict[str, Any] = {}
    for topic in survey.of_role("color"):
        if topic.name.startswith(folder):
            name = topic.name.removeprefix(folder).removesuffix("_image")
            cameras[name] = {"color": topic.name}
            if f"{folder}{name}_depth" in paths:
                cameras[name]["depth"] = f"{folder}{name}_depth"
    robot = "obs/robot0_"
    if {f"{robot}eef_pos", f"{robot}eef_quat", f"{robot}gripper_qpos"} <= set(paths):
        # Its actions are steps of a controller, not poses: what was reached is the target.
        hand = {"topic": [f"{robot}eef_pos", f"{robot}eef_quat"], "layout": "xyz_quat_xyzw"}
        state: dict[str, Any] = {"hand": hand, "gripper": {"topic": f"{robot}gripper_qpos"}}
        if f"{robot}joint_pos" in paths:
            state["joints"] = {"topic": f"{robot}joint_pos"}
        return {"cameras": cameras, "state": state, "action": {"from": "next_state"}}
    low = [t.name for t in survey.of_role("number") if t.name.startswith(folder)]
    return {
        "cameras": cameras,
        "state": {"joints": {"topic": low}},
        "action": {"from": "command", "joints": {"topic": "actions"}},
    }


def _maniskill(survey: Survey, paths: dict[str, Any]) -> dict[str, Any]:
    cameras: dict[str, Any] = {}
    for topic in survey.of_role("color"):
        folder, _, kind = topic.name.rpartition("/")
        if kind == "rgb":
            name = folder.rpartition("/")[2]
            cameras[name] = {"color": topic.name}
            if f"{folder}/depth" in paths:
                cameras[name]["depth"] = f"{folder}/depth"
            if f"obs/sensor_param/{name}/intrinsic_cv" in paths:
                cameras[name]["info"] = f"obs/sensor_param/{name}"
    state: dict[str, Any] = {"joints": {"topic": "obs/agent/qpos"}}
    action: dict[str, Any] = {"from": "command", "joints": {"topic": "actions"}}
    if "obs/extra/tcp_pose" in paths:
        fingers = _width(paths, "obs/agent/qpos")
        state["hand"] = {"topic": "obs/extra/tcp_pose", "layout": "xyz_quat_wxyz"}
        state["gripper"] = {"topic": "obs/agent/qpos", "columns": [fingers - 2, fingers]}
        action = {"from": "next_state"}
    return {"source": "simulation", "cameras": cameras, "state": state, "action": action}


def _zarr(survey: Survey, paths: dict[str, Any]) -> dict[str, Any]:
    cameras: dict[str, Any] = {}
    depth = [t.name for t in survey.of_role("depth")]
    for topic in survey.of_role("color"):
        name = "camera" if topic.name == "img" else topic.name.removeprefix("img_")
        cameras[name] = {"color": topic.name}
        if topic.name.replace("img_", "depth_") in depth:
            cameras[name]["depth"] = topic.name.replace("img_", "depth_")
        elif depth and len(survey.of_role("color")) == 1:
            cameras[name]["depth"] = depth[0]
    state = next((n for n in ("state", "robot_eef_pose", "agent_pos") if n in paths), None)
    numbers = [t.name for t in survey.of_role("number") if t.name != "action"]
    return {
        "cameras": cameras,
        "state": {"joints": {"topic": state or numbers}},
        "action": {"from": "command", "joints": {"topic": "action"}},
    }


def _width(paths: dict[str, Any], name: str) -> int:
    """Numbers in a row of a data set; 0 when it is missing."""
    if name not in paths:
        return 0
    shape = paths[name].type.partition("(")[2].rstrip("),")
    return int(shape.split(",")[0]) if shape else 1
