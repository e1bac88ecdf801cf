"""Judges one episode folder against its contract: every finding says where, what, and what to do.

It reads every byte. Checks go on after a finding as long as what they need can be read.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from codediffuser.datagen import episode_format as fmt
from codediffuser.datagen.episode import Episode, load_manifest
from codediffuser.datagen.log_reader import READ_ERRORS
from codediffuser.datagen.trajectory import ACTION_NAMES
from codediffuser.datagen.views import moment_at
from codediffuser.errors import CodeDiffuserError
from codediffuser.files import sha256_file
from codediffuser.poses import matrix_to_rot6d

# Float32 of a pose that went through a quaternion: a few units in the last place.
POSE_TOLERANCE = 1e-5
BLACK = 8
"""A picture whose brightest value of 255 is below this shows nothing."""
FROZEN_S = 1.0
"""A camera that repeats itself for longer hangs, if something moved meanwhile."""
STILL_M = 0.10
"""The hand cannot cross this much of the scene unseen by a working camera."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong."""

    kind: str
    """What sort of damage: `episode.bytes`, `dataset.time`, ...; docs/keeping.md lists them."""
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
        remedy = "delete the folder and make the episode again"
        return [Finding("episode.manifest", str(folder), str(error), remedy)]
    findings = list(_check_files(episode))
    if findings:
        # What follows would only repeat in other words that bytes are missing or changed.
        return findings
    for check in (_check_messages, _check_pictures, _check_motion, _check_scene, _check_outcome):
        try:
            findings += check(episode)
        except CodeDiffuserError as error:
            findings.append(Finding("episode.unreadable", str(folder), str(error), episode.remedy))
        except READ_ERRORS as error:
            what = f"cannot be read ({type(error).__name__}: {error})"
            findings.append(
                Finding("episode.unreadable", str(episode.log_path), what, episode.remedy)
            )
    return findings


def _check_files(episode: Episode) -> Iterator[Finding]:
    for name, record in episode.manifest.files.items():
        path = episode.folder / name
        size = path.stat().st_size if path.is_file() else None
        if size != record.bytes:
            found = "no file" if size is None else f"{size} bytes"
            kind = "episode.file-missing" if size is None else "episode.bytes"
            what = f"expected {record.bytes} bytes, found {found}"
            yield Finding(kind, str(path), what, episode.remedy)
        elif sha256_file(path) != record.sha256:
            what = f"its SHA-256 differs from the one in {fmt.MANIFEST}"
            yield Finding("episode.hash", str(path), what, episode.remedy)


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
            what = f"{topic}: expected {expected} messages, found {found}"
            yield Finding("episode.messages", log, what, episode.remedy)
    per_step = [*manifest.motion.step_topics]
    for camera in manifest.cameras:
        per_step.append(fmt.color_topic(camera.name))
        if camera.depth:
            per_step.append(fmt.depth_topic(camera.name))
    expected_times = [fmt.step_time_ns(k, manifest.hz) for k in range(manifest.frames)]
    for topic in per_step:
        if times[topic] != expected_times:
            what = (
                f"{topic}: expected {manifest.frames} messages at every 1/{manifest.hz} s from 0, "
                f"found {len(times[topic])} at other times"
            )
            yield Finding("episode.time", log, what, episode.remedy)


def _check_pictures(episode: Episode) -> Iterator[Finding]:
    """Size of every picture, that each camera sees something, and that it keeps seeing."""
    cameras, log = {c.name: c for c in episode.manifest.cameras}, str(episode.log_path)
    seen = {name: not camera.depth for name, camera in cameras.items()}
    wrong: dict[str, int] = {}
    black: dict[str, list[int]] = defaultdict(list)
    repeats: dict[str, list[bool]] = defaultdict(list)
    last: dict[str, np.ndarray] = {}
    for frame in episode.frames():
        for name, camera in cameras.items():
            shape = (camera.height, camera.width)
            pictures = [frame.rgb[name], *([frame.depth_m[name]] if camera.depth else [])]
            if any(picture.shape[:2] != shape for picture in pictures):
                wrong.setdefault(name, frame.index)
            seen[name] = seen[name] or bool(frame.depth_m[name].any())
            if frame.rgb[name].max() < BLACK:
                black[name].append(frame.index)
            if name in last:
                repeats[name].append(np.array_equal(last[name], frame.rgb[name]))
            last[name] = frame.rgb[name]
    for name, index in wrong.items():
        shape = (cameras[name].height, cameras[name].width)
        what = f"camera '{name}': expected pictures of {shape}, frame {index} has others"
        yield Finding("episode.picture-size", log, what, episode.remedy)
    for name in (n for n, anything in seen.items() if not anything):
        remedy = "check where the camera stands and looks, then draw the pictures again"
        what = f"camera '{name}': no depth reading in any frame"
        yield Finding("episode.no-depth", log, what, remedy)
    remedy = "check the camera and its cable; record the episode again, or leave it out"
    for name, frames in black.items():
        what = f"camera '{name}': {len(frames)} black pictures, first {frames[0]}"
        yield Finding("episode.black", log, what, remedy)
    if episode.manifest.source == "simulation":
        return  # Rendered pictures have no noise: they repeat where the camera sees nothing move.
    remedy += "; if a simulator was recorded, say 'source: simulation' in import.yaml"
    for name, same in repeats.items():
        first, count = longest_repeat(same)
        if count > FROZEN_S * episode.manifest.hz and _travelled_m(episode, first, count) > STILL_M:
            what = f"camera '{name}': the same picture {count} times in a row from frame {first} on"
            yield Finding("episode.frozen", log, f"{what}, while the hand moved", remedy)


def longest_repeat(same_as_last: Sequence[bool]) -> tuple[int, int]:
    """First picture of the longest run of equal ones, and how many there are.

    Args:
        same_as_last: For each picture but the first, whether it equals the one before.
    """
    best = (0, 1)
    first = 0
    for k, same in enumerate(same_as_last, start=1):
        first = first if same else k
        if k - first + 1 > best[1]:
            best = (first, k - first + 1)
    return best


def _travelled_m(episode: Episode, first: int, count: int) -> float:
    """Extent of the space that the hand crossed in some frames; 0 when its pose is not known."""
    if tuple(episode.manifest.motion.action_names) != ACTION_NAMES:
        return 0.0
    positions = episode.actions[first : first + count, :3]
    return float(np.linalg.norm(positions.max(axis=0) - positions.min(axis=0)))


def _check_motion(episode: Episode) -> Iterator[Finding]:
    """State and actions: finite, and those of the stored trajectory."""
    log, state, actions = str(episode.log_path), episode.state, episode.actions
    for name, rows in (("state", state), ("actions", actions)):
        bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
        if len(bad):
            what = f"{name} of frame {bad[0]} is not finite"
            yield Finding("episode.not-finite", log, what, episode.remedy)
    if fmt.STATES not in episode.manifest.files:
        return
    states, trajectory = str(episode.folder / fmt.STATES), episode.trajectory
    if trajectory.num_steps != episode.num_frames:
        what = f"expected {episode.num_frames} actions, found {trajectory.num_steps}"
        yield Finding("episode.states", states, what, episode.remedy)
        return
    moments = [moment_at(trajectory, k) for k in range(episode.num_frames)]
    hand = np.stack([trajectory.T_world_hand(k) for k in range(episode.num_frames)])
    opening = [m.qpos[-2:].mean() for m in moments]
    stored = np.column_stack([hand[:, :3, 3], matrix_to_rot6d(hand[:, :3, :3]), opening])
    for name, rows, other in (("state", state, stored), ("actions", actions, trajectory.actions)):
        error = float(np.abs(rows - other).max())
        if error > POSE_TOLERANCE:
            what = f"{name} of the log differ by up to {error:.2g} from {fmt.STATES}"
            yield Finding("episode.states", log, what, episode.remedy)


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
            where = str(episode.folder / fmt.SCENE)
            yield Finding("episode.scene", where, what, episode.remedy)
    moving = {o.id for o in scene.objects if not o.fixed}
    if fmt.STATES in manifest.files and set(episode.trajectory.object_ids) != moving:
        what = f"expected states of {sorted(moving)}, found {list(episode.trajectory.object_ids)}"
        where = str(episode.folder / fmt.STATES)
        yield Finding("episode.states", where, what, episode.remedy)


def _check_outcome(episode: Episode) -> Iterator[Finding]:
    """Folder and manifest agree with each other and with what success means."""
    manifest, path = episode.manifest, str(episode.folder / fmt.MANIFEST)
    if episode.folder.name != manifest.id:
        what = f"says id '{manifest.id}', its folder is called '{episode.folder.name}'"
        remedy = f"rename the folder to '{manifest.id}'"
        yield Finding("episode.renamed", path, what, remedy)
    failed = [c.name for c in manifest.conditions if not c.holds]
    if manifest.success and failed:
        what = f"says success, yet these conditions do not hold: {', '.join(failed)}"
        yield Finding("episode.outcome", path, what, episode.remedy)
