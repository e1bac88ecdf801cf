"""Judges one episode folder against its contract: every finding says where, what, and what to do.

It reads every byte. Checks go on after a finding as long as what they need can be read.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from codediffuser.datagen import episode_format as fmt
from codediffuser.datagen.episode import READ_ERRORS, Episode, load_manifest
from codediffuser.datagen.episode_writer import step_time_ns
from codediffuser.datagen.views import moment_at
from codediffuser.errors import CodeDiffuserError
from codediffuser.files import sha256_file
from codediffuser.poses import matrix_to_rot6d

# Float32 of a pose that went through a quaternion: a few units in the last place.
POSE_TOLERANCE = 1e-5


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong."""

    where: str
    """File or folder."""
    what: str
    """What was expected and what was found."""
    remedy: str
    """What to do about it."""


def check_episode(folder: Path) -> list[Finding]:
    """Check files, hashes, messages, times, pictures, states and scene of one episode.

    Returns:
        What is wrong, in the order of the checks; empty for a good episode.
    """
    try:
        episode = Episode(folder, load_manifest(folder))
    except CodeDiffuserError as error:
        return [Finding(str(folder), str(error), "delete the folder and make the episode again")]
    findings = list(_check_files(episode))
    if findings:
        # What follows would only repeat in other words that bytes are missing or changed.
        return findings
    for check in (_check_messages, _check_pictures, _check_motion, _check_scene, _check_outcome):
        try:
            findings += check(episode)
        except CodeDiffuserError as error:
            findings.append(Finding(str(folder), str(error), episode.remedy))
        except READ_ERRORS as error:
            what = f"cannot be read ({type(error).__name__}: {error})"
            findings.append(Finding(str(episode.log_path), what, episode.remedy))
    return findings


def _check_files(episode: Episode) -> Iterator[Finding]:
    for name, record in episode.manifest.files.items():
        path = episode.folder / name
        size = path.stat().st_size if path.is_file() else None
        if size != record.bytes:
            found = "no file" if size is None else f"{size} bytes"
            yield Finding(
                str(path), f"expected {record.bytes} bytes, found {found}", episode.remedy
            )
        elif sha256_file(path) != record.sha256:
            what = f"its SHA-256 differs from the one in {fmt.MANIFEST}"
            yield Finding(str(path), what, episode.remedy)


def _check_messages(episode: Episode) -> Iterator[Finding]:
    """Counts and times of the messages of every topic."""
    log, manifest = str(episode.log_path), episode.manifest
    times: dict[str, list[int]] = defaultdict(list)
    with episode.log_path.open("rb") as stream:
        messages = make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False)
        for _, channel, message in messages:
            times[channel.topic].append(message.log_time)
    for topic in sorted(set(times) | set(manifest.topics)):
        found, expected = len(times[topic]), manifest.topics.get(topic, 0)
        if found != expected:
            yield Finding(
                log, f"{topic}: expected {expected} messages, found {found}", episode.remedy
            )
    per_step = [*manifest.motion.step_topics]
    for camera in manifest.cameras:
        per_step.append(fmt.color_topic(camera.name))
        if camera.depth:
            per_step.append(fmt.depth_topic(camera.name))
    expected_times = [step_time_ns(k, manifest.hz) for k in range(manifest.frames)]
    for topic in per_step:
        if times[topic] != expected_times:
            what = f"{topic}: expected {manifest.frames} messages at every 1/{manifest.hz} s from 0"
            yield Finding(log, f"{what}, found {len(times[topic])} at other times", episode.remedy)


def _check_pictures(episode: Episode) -> Iterator[Finding]:
    """Size of every picture, and that each camera sees something."""
    cameras, log = {c.name: c for c in episode.manifest.cameras}, str(episode.log_path)
    seen = {name: not camera.depth for name, camera in cameras.items()}
    wrong: dict[str, int] = {}
    for frame in episode.frames():
        for name, camera in cameras.items():
            shape = (camera.height, camera.width)
            pictures = [frame.rgb[name], *([frame.depth_m[name]] if camera.depth else [])]
            if any(picture.shape[:2] != shape for picture in pictures):
                wrong.setdefault(name, frame.index)
            seen[name] = seen[name] or bool(frame.depth_m[name].any())
    for name, index in wrong.items():
        shape = (cameras[name].height, cameras[name].width)
        what = f"camera '{name}': expected pictures of {shape}, frame {index} has others"
        yield Finding(log, what, episode.remedy)
    for name in (n for n, anything in seen.items() if not anything):
        remedy = "check where the camera stands and looks, then draw the pictures again"
        yield Finding(log, f"camera '{name}': no depth reading in any frame", remedy)


def _check_motion(episode: Episode) -> Iterator[Finding]:
    """State and actions: finite, and those of the stored trajectory."""
    log, state, actions = str(episode.log_path), episode.state, episode.actions
    for name, rows in (("state", state), ("actions", actions)):
        bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
        if len(bad):
            yield Finding(log, f"{name} of frame {bad[0]} is not finite", episode.remedy)
    if fmt.STATES not in episode.manifest.files:
        return
    states, trajectory = str(episode.folder / fmt.STATES), episode.trajectory
    if trajectory.num_steps != episode.num_frames:
        what = f"expected {episode.num_frames} actions, found {trajectory.num_steps}"
        yield Finding(states, what, episode.remedy)
        return
    moments = [moment_at(trajectory, k) for k in range(episode.num_frames)]
    hand = np.stack([trajectory.T_world_hand(k) for k in range(episode.num_frames)])
    opening = [m.qpos[-2:].mean() for m in moments]
    stored = np.column_stack([hand[:, :3, 3], matrix_to_rot6d(hand[:, :3, :3]), opening])
    for name, rows, other in (("state", state, stored), ("actions", actions, trajectory.actions)):
        error = float(np.abs(rows - other).max())
        if error > POSE_TOLERANCE:
            what = f"{name} of the log differ by up to {error:.2g} from {fmt.STATES}"
            yield Finding(log, what, episode.remedy)


def _check_scene(episode: Episode) -> Iterator[Finding]:
    """The scene that lies beside the log is the one that the manifest tells of."""
    if fmt.SCENE not in episode.manifest.files:
        return
    scene, manifest = episode.scene, episode.manifest
    for key, found, expected in (
        ("task", scene.task, manifest.task),
        ("scene_id", scene.scene_id, manifest.id),
        ("instruction", scene.instruction.text, manifest.instruction),
        ("seed", scene.seed, manifest.seed),
    ):
        if found != expected:
            what = f"{key}: expected {expected!r} as in {fmt.MANIFEST}, found {found!r}"
            yield Finding(str(episode.folder / fmt.SCENE), what, episode.remedy)
    moving = {o.id for o in scene.objects if not o.fixed}
    if fmt.STATES in manifest.files and set(episode.trajectory.object_ids) != moving:
        what = f"expected states of {sorted(moving)}, found {list(episode.trajectory.object_ids)}"
        yield Finding(str(episode.folder / fmt.STATES), what, episode.remedy)


def _check_outcome(episode: Episode) -> Iterator[Finding]:
    """Folder and manifest agree with each other and with what success means."""
    manifest, path = episode.manifest, str(episode.folder / fmt.MANIFEST)
    if episode.folder.name != manifest.id:
        what = f"says id '{manifest.id}', its folder is called '{episode.folder.name}'"
        yield Finding(path, what, f"rename the folder to '{manifest.id}'")
    failed = [c.name for c in manifest.conditions if not c.holds]
    if manifest.success and failed:
        what = f"says success, yet these conditions do not hold: {', '.join(failed)}"
        yield Finding(path, what, episode.remedy)
