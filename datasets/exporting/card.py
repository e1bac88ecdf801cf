"""The card of a dataset: `README.md` with pictures, for people and for the Hugging Face Hub."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from codediffuser.datagen.episode import Episode, load_manifest
from codediffuser.datagen.episode_format import EpisodeManifest
from codediffuser.datasets.export_meta import CARD, DatasetDocument
from codediffuser.datasets.exporting.card_pictures import draw_pictures
from codediffuser.datasets.splits import split_episodes
from codediffuser.files import write_text
from codediffuser.labeling.store import load_labels

EXAMPLES = 8
"""Sentences that the card quotes."""

OPEN_WITH = {
    "lerobot": """```python
from lerobot.datasets.lerobot_dataset import LeRobotDataset

dataset = LeRobotDataset("local/{name}", root="{name}")
```""",
    "zarr": """```python
import zarr

data = zarr.open("{name}/replay_buffer.zarr", mode="r")
data["data/action"], data["meta/episode_ends"]
```""",
    "robomimic": """```python
import h5py

with h5py.File("{name}/demo.hdf5") as file:
    file["data/demo_0/obs"].keys(), file["data/demo_0/actions"]
```""",
    "aloha": """```python
import h5py

with h5py.File("{name}/episode_0.hdf5") as file:
    file["observations/qpos"], file["observations/images"].keys(), file["action"]
```""",
    "maniskill": """```python
from mani_skill.trajectory.dataset import ManiSkillTrajectoryDataset

dataset = ManiSkillTrajectoryDataset("{name}/trajectory.h5", success_only=True)
```""",
    "rosbag2": """```
ros2 bag info {name}/{first}
ros2 bag play {name}/{first}
```

Without ROS:

```python
from pathlib import Path

from rosbags.highlevel import AnyReader

with AnyReader([Path("{name}/{first}")]) as bag:
    for connection, time_ns, data in bag.messages():
        message = bag.deserialize(data, connection.msgtype)
```

Foxglove opens the `.mcap` file in each folder.""",
}


def write_card(
    root: Path, document: DatasetDocument, folders: Sequence[Path], labelled: bool
) -> None:
    """Write `README.md` and its pictures into an export.

    Args:
        root: The export.
        document: What it says about itself.
        folders: Its episodes, in order.
        labelled: Whether these have labels.
    """
    manifests = [load_manifest(folder) for folder in folders]
    drawn = draw_pictures(root, [Episode.open(f) for f in _spread(folders)], labelled)
    sections = [
        _front_matter(document),
        _summary(document, manifests),
        *(f"![{caption}]({name})\n\n*{caption}*" for name, caption in drawn.items()),
        _contents(document, manifests),
        _instructions(manifests),
        _targets(folders) if labelled else "",
        _splits(document),
        _origin(document),
        "## Open it\n\n"
        + OPEN_WITH[document.format].format(name=root_name(document), first=manifests[0].id),
    ]
    write_text(root / CARD, "\n\n".join(section for section in sections if section) + "\n")


def root_name(document: DatasetDocument) -> str:
    """How the card calls the folder."""
    return "lerobot" if document.format == "lerobot" else f"{document.format}-{document.profile}"


def _spread(folders: Sequence[Path], count: int = 4) -> list[Path]:
    """Evenly spread episodes, the first and the last among them."""
    if len(folders) <= count:
        return list(folders)
    return [folders[round(i * (len(folders) - 1) / (count - 1))] for i in range(count)]


def _front_matter(document: DatasetDocument) -> str:
    lines = ["---", "license: other", "license_name: see-card", "task_categories:", "- robotics",
             "tags:", f"- {'LeRobot' if document.format == 'lerobot' else document.format}",
             "- codediffuser", f"- {document.profile}"]  # fmt: skip
    if document.format == "lerobot":
        lines += ["configs:", "- config_name: default", "  data_files: data/*/*.parquet"]
    return "\n".join([*lines, "---"])


def _summary(document: DatasetDocument, manifests: Sequence[EpisodeManifest]) -> str:
    frames = [m.frames for m in manifests]
    kinds = Counter[str](m.source for m in manifests)
    hz = manifests[0].hz
    return (
        f"# {document.task}\n\n"
        f"{len(manifests)} demonstrations ({_listed(kinds)}), {sum(frames)} frames at {hz} Hz, "
        f"{sum(frames) / hz / 60:.1f} minutes; {min(frames)} to {max(frames)} frames each. "
        f"Format {document.format}, profile {document.profile}."
    )


def _contents(document: DatasetDocument, manifests: Sequence[EpisodeManifest]) -> str:
    first = manifests[0]
    rows = [
        ("state", f"{len(first.motion.state_names)} numbers", ", ".join(first.motion.state_names)),
        ("action", f"{len(first.motion.action_names)} numbers",
         ", ".join(first.motion.action_names)),
    ]  # fmt: skip
    if document.cloud is not None:
        rows.append(
            ("cloud", f"{document.cloud.num_points} points", "x, y, z in world metres, attention "
             "for picking and placing")
        )  # fmt: skip
    else:
        rows += [
            (f"camera {c.name}", f"{c.width} x {c.height}",
             ", ".join(["colour"] + ["depth"] * c.depth + ["calibrated"] * c.calibrated))
            for c in first.cameras
        ]  # fmt: skip
    table = "\n".join(f"| {a} | {b} | {c} |" for a, b, c in rows)
    return f"## What a frame holds\n\n| part | size | meaning |\n|---|---|---|\n{table}"


def _instructions(manifests: Sequence[EpisodeManifest]) -> str:
    counts = Counter(m.instruction for m in manifests)
    quoted = "\n".join(f"- {text} ({n})" for text, n in counts.most_common(EXAMPLES))
    more = f"\n- and {len(counts) - EXAMPLES} more" if len(counts) > EXAMPLES else ""
    return f"## Instructions\n\n{len(counts)} different sentences.\n\n{quoted}{more}"


def _targets(folders: Sequence[Path]) -> str:
    """Who labelled, and how many points targets have."""
    rows: Counter[tuple[str, str, str]] = Counter()
    points: dict[tuple[str, str, str], list[int]] = {}
    for folder in folders:
        for label in load_labels(folder).labels:
            key = (label.role, label.category, label.provenance.source)
            rows[key] += 1
            points.setdefault(key, []).append(len(label.points_world))
    table = "\n".join(
        f"| {role} | {category} | {source} | {n} | {min(points[k])} to {max(points[k])} |"
        for k, n in sorted(rows.items())
        for role, category, source in [k]
    )
    head = "| role | category | set by | episodes | points |\n|---|---|---|---|---|"
    return f"## Attention\n\n{head}\n{table}"


def _splits(document: DatasetDocument) -> str:
    ids = [episode.episode_id for episode in document.episodes]
    train, val = split_episodes(ids)
    held = ", ".join(ids[i] for i in val) or "none"
    return (
        "## Splits\n\n"
        f"By the hash of each episode's id: {len(train)} train, {len(val)} validate ({held}). "
        "Adding episodes moves none to the other side."
    )


def _origin(document: DatasetDocument) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in document.versions.items())
    left_out = ", ".join(document.left_out) or "none"
    rejected = ", ".join(document.rejected) or "none"
    return (
        "## Origin\n\n"
        f"Run `{document.source}`, converted by codediffuser at commit `{document.git_commit}` "
        f"({versions}). Content SHA-256 `{document.content_sha256}`. "
        f"Episodes left out because they did not succeed: {left_out}; because a reviewer rejected "
        f"their labels: {rejected}.\n\n"
        "Licence: that of the recordings. Simulated scenes are procedural and carry no licence of "
        "their own; the robot model is ManiSkill's Panda."
    )


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{n} from {kind}" for kind, n in sorted(counts.items()))
