"""The four formats with one row per frame, by the layout that their owners publish.

Sources: tonyzhaozh/aloha `record_episodes.py`; robomimic documentation, "Dataset contents";
mani_skill/utils/wrappers/record.py; real-stanford/diffusion_policy `replay_buffer.py`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from codediffuser.datasets.importing.array_file import ArrayFile, Column, natural_order
from codediffuser.errors import DatasetError
from codediffuser.poses import invert_transform

HALF_PIXEL = 0.5
"""ManiSkill counts pixels from the outer corner of the first, we from its centre."""


class _Hdf5File(ArrayFile):
    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._file = _opened(path)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _columns(self, group: h5py.Group, length: int) -> dict[str, Column]:
        """All data sets below a group with a row for every frame; some formats add a last one."""
        found: dict[str, Column] = {}

        def visit(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset) and item.ndim and len(item) in (length, length + 1):
                found[name] = Column(item, 0, length)

        group.visititems(visit)
        return found


class AlohaFile(_Hdf5File):
    """One `episode_<n>.hdf5`: `observations/qpos`, `observations/images/<camera>`, `action`."""

    format = "aloha"
    hz = 50

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.episodes = [path.stem]
        self.hz = int(self._file.attrs.get("hz", self.hz))

    def columns(self, episode: str) -> dict[str, Column]:
        """See `ArrayFile.columns`."""
        return self._columns(self._file, len(self._file["action"]))

    def instruction(self, episode: str) -> str:
        """An attribute of the file, as ours and some forks of ALOHA write it."""
        return _told(self._file.attrs)


class RobomimicFile(_Hdf5File):
    """`data/demo_<i>/{obs/..., actions, dones, rewards}`."""

    format = "robomimic"
    hz = 20

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.episodes = sorted(self._file["data"], key=natural_order)
        arguments = json.loads(self._file["data"].attrs.get("env_args", "{}"))
        self.hz = int(arguments.get("env_kwargs", {}).get("control_freq", self.hz))

    def columns(self, episode: str) -> dict[str, Column]:
        """See `ArrayFile.columns`."""
        group = self._file["data"][episode]
        return self._columns(group, len(group["actions"]))

    def success(self, episode: str) -> bool | None:
        """Rewards are sparse: any positive one is a success."""
        group = self._file["data"][episode]
        if "rewards" not in group:
            return None
        return bool(np.asarray(group["rewards"]).max(initial=0) > 0)

    def instruction(self, episode: str) -> str:
        """An attribute of the demonstration, or LIBERO's of the whole file."""
        own = _told(self._file["data"][episode].attrs)
        if own:
            return own
        problem = json.loads(self._file["data"].attrs.get("problem_info", "{}"))
        return str(problem.get("language_instruction", ""))


class ManiSkillFile(_Hdf5File):
    """`traj_<i>/{obs/..., actions, success}` with a JSON file beside it."""

    format = "maniskill"
    hz = 20

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.episodes = sorted((n for n in self._file if n.startswith("traj_")), key=natural_order)
        beside = path.with_suffix(".json")
        self._facts: dict[str, Any] = json.loads(beside.read_text()) if beside.is_file() else {}
        kwargs = self._facts.get("env_info", {}).get("env_kwargs", {})
        frequency = kwargs.get("sim_config", {}).get("control_freq", self.hz)
        self.hz = int(frequency)

    def columns(self, episode: str) -> dict[str, Column]:
        """See `ArrayFile.columns`; observations have one row more than actions."""
        group = self._file[episode]
        return self._columns(group, len(group["actions"]))

    def success(self, episode: str) -> bool | None:
        """The last flag of the trajectory, or what the JSON file says."""
        group = self._file[episode]
        if "success" in group and len(group["success"]):
            return bool(group["success"][-1])
        number = natural_order(episode)[1]
        for facts in self._facts.get("episodes", ()):
            if facts.get("episode_id") == number and "success" in facts:
                return bool(np.any(facts["success"]))
        return None

    def instruction(self, episode: str) -> str:
        """An attribute of the trajectory, as ours have it."""
        return _told(self._file[episode].attrs)

    def calibration(self, episode: str, group: str) -> tuple[np.ndarray, np.ndarray]:
        """From `obs/sensor_param/<camera>`; see `ArrayFile.calibration`."""
        parameters = self._file[episode].get(group)
        if parameters is None or "intrinsic_cv" not in parameters:
            raise DatasetError(f"{self.path}: {episode} has no camera parameters at '{group}'")
        K = np.array(parameters["intrinsic_cv"][0], np.float64)
        K[:2, 2] -= HALF_PIXEL
        extrinsic = np.asarray(parameters["extrinsic_cv"], np.float64)
        T_camera_world = np.tile(np.eye(4), (len(extrinsic), 1, 1))
        T_camera_world[:, :3] = extrinsic[:, :3]
        return K, np.stack([invert_transform(T) for T in T_camera_world])


class ReplayBufferFile(ArrayFile):
    """A zarr group with `data/<name>` and `meta/episode_ends`: a folder or a `.zarr.zip`."""

    format = "zarr"
    hz = 10

    def __init__(self, path: Path) -> None:
        import zarr

        super().__init__(path)
        try:
            store = zarr.ZipStore(str(path), mode="r") if path.is_file() else str(path)
            self._root = zarr.open_group(store, mode="r")
            self._ends = np.asarray(self._root["meta/episode_ends"], np.int64)
            self._data = dict(self._root["data"].arrays())
        except (KeyError, ValueError, OSError) as error:
            raise DatasetError(
                f"{path}: is no zarr replay buffer with data/ and meta/episode_ends ({error})"
            ) from None
        self.episodes = [str(i) for i in range(len(self._ends))]
        self.hz = int(self._root.attrs.get("hz", self.hz))
        rows = int(self._ends[-1]) if len(self._ends) else 0
        short = [name for name, array in self._data.items() if len(array) < rows]
        for name in short:
            self.damage.append(f"data/{name} has {len(self._data.pop(name))} of {rows} rows")

    def close(self) -> None:
        """Close a packed store."""
        close = getattr(self._root.store, "close", None)
        if close is not None:
            close()

    def columns(self, episode: str) -> dict[str, Column]:
        """See `ArrayFile.columns`."""
        i = int(episode)
        start = int(self._ends[i - 1]) if i else 0
        length = int(self._ends[i]) - start
        return {name: Column(array, start, length) for name, array in self._data.items()}

    def instruction(self, episode: str) -> str:
        """From the group's attributes, as ours have it."""
        told = self._root.attrs.get("instructions", ())
        return str(told[int(episode)]) if len(told) == len(self.episodes) else ""


def _told(attributes: Any) -> str:
    """The instruction among the attributes of an episode; empty for none."""
    names = ("language_instruction", "instruction", "lang")
    return next((str(attributes[name]) for name in names if name in attributes), "")


def open_hdf5(path: Path) -> ArrayFile:
    """Open an HDF5 file by what it holds.

    Raises:
        DatasetError: It is none of the known layouts.
    """
    with _opened(path) as file:
        kind, names = _kind(file), sorted(file)
    if kind is None:
        raise DatasetError(
            f"{path}: expected ALOHA (observations/qpos, action), robomimic (data/demo_<i>) or "
            f"ManiSkill (traj_<i>), found {', '.join(names) or 'nothing'}"
        )
    return kind(path)


def _opened(path: Path) -> h5py.File:
    try:
        return h5py.File(path, "r")
    except OSError as error:
        raise DatasetError(f"{path}: is no HDF5 file, or is cut off ({error})") from None


def _kind(file: h5py.File) -> type[_Hdf5File] | None:
    if "observations" in file and "action" in file:
        return AlohaFile
    if "data" in file and any(name.startswith("demo") for name in file["data"]):
        return RobomimicFile
    if any(name.startswith("traj_") for name in file):
        return ManiSkillFile
    return None
