"""Surveys of LeRobot datasets, ours or anybody's: tables are read, pictures are not decoded."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from codediffuser.datagen.episode_format import EPISODES, SCENE
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datasets import parquet_reader
from codediffuser.datasets.export_meta import DatasetDocument, find_document, load_info
from codediffuser.datasets.features import (
    ACTION,
    DEFAULT_FEATURES,
    EPISODE_ID,
    LABELS,
    POINT_CHANNELS,
    POINTS,
    STATE,
)
from codediffuser.datasets.inspecting.run_survey import scene_facts
from codediffuser.datasets.inspecting.survey import (
    NOT_RECORDED,
    EpisodeFacts,
    FeatureFacts,
    LabelFacts,
    Motion,
    Survey,
    bytes_below,
    resample,
    spread,
)
from codediffuser.errors import CodeDiffuserError

PARTS = {"tables": "data", "videos": "videos", "meta": "meta", "card": "card"}
LEFT_OUT = "left out of the export: no success"
REJECTED = "left out of the export: labels rejected"


def survey_dataset(root: Path) -> Survey:
    """Read what a LeRobot dataset holds.

    Instruction kinds, splits and places come from the scenes of the run that the dataset lies in,
    when it still lies there; a dataset has no slot for them.

    Raises:
        DatasetError: There is no dataset, or it is damaged.
    """
    info, document = load_info(root), find_document(root)
    rows = parquet_reader.read_episode_rows(root)
    firsts = _first_rows(root, info, len(rows), (EPISODE_ID, LABELS))
    features = {k: f for k, f in info["features"].items() if k not in DEFAULT_FEATURES}
    source = document.source if document else ""
    code = f"{document.versions.get('codediffuser', NOT_RECORDED)} ({document.git_commit})" \
        if document else NOT_RECORDED  # fmt: skip
    return Survey(
        path=root,
        what="LeRobot dataset",
        episodes=tuple(
            EpisodeFacts(
                id=first.get(EPISODE_ID, str(i)),
                task=document.task if document else str(info.get("robot_type")),
                instruction="; ".join(row["tasks"]),
                frames=int(row["length"]),
                hz=float(info["fps"]),
                labels=_labels(first.get(LABELS, "")),
                code=code,
                **_scene_beside(root, source, first.get(EPISODE_ID, "")),
            )
            for i, (row, first) in enumerate(zip(rows, firsts, strict=True))
        ),
        features=tuple(_feature(name, value) for name, value in features.items()),
        cameras={
            name.removeprefix("observation.images."): f"{_size(value)}, {value['dtype']}"
            for name, value in features.items()
            if value["dtype"] in ("video", "image")
        },
        bytes_by_part={
            part: size for part, name in PARTS.items() if (size := bytes_below([root / name]))
        },
        failed=_left_out(document) if document else {},
    )


def _left_out(document: DatasetDocument) -> dict[str, int]:
    counts = {LEFT_OUT: len(document.left_out), REJECTED: len(document.rejected)}
    return {why: count for why, count in counts.items() if count}


def dataset_motion(root: Path, *, moments: int = 60, most: int = 64) -> Motion | None:
    """State, actions and counts of attended points; None for a dataset without these columns.

    Args:
        root: The dataset.
        moments: M, rows of each episode that are kept.
        most: At most that many evenly spread episodes are read.

    Raises:
        DatasetError: A file is damaged.
    """
    info, rows = load_info(root), parquet_reader.read_episode_rows(root)
    columns = {k: _length(info, k) for k in (STATE, ACTION) if k in info["features"]}
    if len(columns) < 2:
        return None
    clouds = POINTS in info["features"] and _length(info, POINTS) % len(POINT_CHANNELS) == 0
    wanted = {i: None for i in spread(len(rows), most)}
    keys = ["episode_index", *columns, *([POINTS] if clouds else [])]
    found: dict[int, list[dict[str, np.ndarray]]] = {i: [] for i in wanted}
    for batch in parquet_reader.iterate(root, keys):
        index = batch.column(0).to_numpy()
        if not any(i in found for i in np.unique(index)):
            continue
        values = {k: parquet_reader.vectors(batch.column(k), n, k) for k, n in columns.items()}
        if clouds:
            flat = parquet_reader.vectors(batch.column(POINTS), _length(info, POINTS), POINTS)
            channels = flat.reshape(len(flat), -1, len(POINT_CHANNELS))[:, :, 3:]
            values[POINTS] = (channels > 0).sum(axis=1)
        for i in np.unique(index):
            if int(i) in found:
                found[int(i)].append({k: v[index == i] for k, v in values.items()})
    stacked = {
        k: np.stack([
            resample(np.concatenate([part[k] for part in parts]), moments)
            for parts in found.values() if parts
        ])
        for k in [*columns, *([POINTS] if clouds else [])]
    }  # fmt: skip
    return Motion(
        stacked[STATE], stacked[ACTION], column_names(info, STATE), column_names(info, ACTION),
        stacked.get(POINTS),
    )  # fmt: skip


def episode_names(root: Path, count: int) -> tuple[str, ...]:
    """Ids of the first episodes of a dataset; the number of one whose rows name none.

    Args:
        root: The dataset.
        count: How many episodes it has.

    Raises:
        DatasetError: A file is damaged.
    """
    firsts = _first_rows(root, load_info(root), count, (EPISODE_ID,))
    return tuple(first.get(EPISODE_ID, str(i)) for i, first in enumerate(firsts))


def _first_rows(
    root: Path, info: Mapping[str, Any], count: int, wanted: Sequence[str]
) -> list[dict[str, str]]:
    """Texts of each episode's first frame, those that are wanted and there."""
    keys = [k for k in wanted if k in info["features"]]
    first: dict[int, dict[str, str]] = {}
    if keys:
        for batch in parquet_reader.iterate(root, ["episode_index", *keys]):
            index = batch.column(0).to_numpy()
            for i, row in zip(*np.unique(index, return_index=True), strict=True):
                texts = {key: batch.column(key)[int(row)].as_py() for key in keys}
                first.setdefault(int(i), texts)
    return [first.get(i, {}) for i in range(count)]


def _labels(text: str) -> tuple[LabelFacts, ...]:
    try:
        found = json.loads(text)["labels"]
        return tuple(
            LabelFacts(
                str(e["role"]), str(e["category"]), str(e["provenance"]["source"]),
                int(e["num_points"]),
            )
            for e in found
        )  # fmt: skip
    except (ValueError, KeyError, TypeError):
        # A column of that name in a dataset of somebody else means something else.
        return ()


def _scene_beside(root: Path, source: str, episode_id: str) -> dict[str, Any]:
    """Facts of the scene file of the run that holds the dataset, if it is the one of its origin."""
    runs = [folder for folder in root.resolve().parents[:2] if folder.name == source]
    if not episode_id or not runs:
        return {}
    path = runs[0] / EPISODES / episode_id / SCENE
    if not path.is_file():
        return {}
    try:
        return scene_facts(SceneSpec.load(path))
    except CodeDiffuserError:
        return {}


def _feature(name: str, value: Mapping[str, Any]) -> FeatureFacts:
    names = value.get("names")
    note = ""
    if name == POINTS and isinstance(names, Mapping) and "channels" in names:
        each = len(names["channels"])
        note = f"{value['shape'][0] // each} points of {', '.join(names['channels'])}"
    elif isinstance(names, Sequence) and value["dtype"] not in ("video", "image"):
        note = ", ".join(str(n) for n in names)
    return FeatureFacts(name, str(value["dtype"]), tuple(value["shape"]), note)


def _size(value: Mapping[str, Any]) -> str:
    height, width = value["shape"][:2] if value["shape"][-1] == 3 else value["shape"][1:]
    return f"{width} x {height}"


def _length(info: Mapping[str, Any], key: str) -> int:
    return int(np.prod(info["features"][key]["shape"]))


def column_names(info: Mapping[str, Any], key: str) -> tuple[str, ...]:
    """What a column calls its numbers: their positions when nobody says, none without a column."""
    if key not in info["features"]:
        return ()
    names, length = info["features"][key].get("names"), _length(info, key)
    if isinstance(names, Mapping):  # some writers group them: {"motors": [...]}
        names = [n for group in names.values() for n in group]
    if not isinstance(names, Sequence) or len(names) != length:
        return tuple(str(i) for i in range(length))
    return tuple(str(n) for n in names)
