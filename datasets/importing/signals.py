"""The signals that a configuration asks for: name, topic, how old, how sampled."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from codediffuser.datasets.importing.config import ImportConfig, NumberSource, PoseSource
from codediffuser.datasets.importing.sampler import Method
from codediffuser.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Signal:
    """One thing that every frame takes from a topic."""

    name: str
    """`camera.front.color`, `state.hand`, `action.gripper`, ..."""
    topic: str
    method: Method
    max_age_ns: int


def signals_of(config: ImportConfig) -> list[Signal]:
    """All signals from topics, in the order in which a step needs them.

    Poses from the transform tree are not among them: their topics serve many frames.

    Raises:
        ConfigError: Several topics are given where a bag needs one.
    """
    default_s = config.sync.max_age_s
    found = []
    for name, camera in config.cameras.items():
        age = round((camera.max_age_s or default_s) * 1e9)
        found.append(Signal(f"camera.{name}.color", camera.color, "latest", age))
        if camera.depth is not None:
            found.append(Signal(f"camera.{name}.depth", camera.depth, "latest", age))
    for name, source in sources_of(config):
        topic = source.topic
        if not topic:
            continue
        if isinstance(topic, tuple):
            raise ConfigError(f"{name}: in a bag one topic is needed, got {', '.join(topic)}")
        method: Method = "linear" if source.interpolate else "latest"
        if name.startswith("action") and config.action.when == "next_frame":
            method = "next"
        age = round((source.max_age_s or default_s) * 1e9)
        found.append(Signal(name, topic, method, age))
    return found


def sources_of(config: ImportConfig) -> Iterator[tuple[str, PoseSource | NumberSource]]:
    """Name and source of every part of state and action that is configured."""
    parts: tuple[tuple[str, PoseSource | NumberSource | None], ...] = (
        ("state.joints", config.state.joints),
        ("state.hand", config.state.hand),
        ("state.gripper", config.state.gripper),
        ("action.hand", config.action.hand),
        ("action.gripper", config.action.gripper),
        ("action.joints", config.action.joints),
    )
    for name, source in parts:
        if source is not None:
            yield name, source


def tree_frames(config: ImportConfig) -> dict[str, tuple[str, int]]:
    """Frames that are looked up in the transform tree at every frame, by signal: name and age."""
    default_s = config.sync.max_age_s
    return {
        name: (source.frame, round((source.max_age_s or default_s) * 1e9))
        for name, source in sources_of(config)
        if isinstance(source, PoseSource) and source.frame is not None
    }


def describe_action(config: ImportConfig) -> str:
    """Where actions come from, in words, for the manifest."""
    if config.action.origin == "next_state":
        return "the state of the following frame"
    topics = [
        str(source.topic or getattr(source, "frame", ""))
        for name, source in sources_of(config)
        if name.startswith("action")
    ]
    when = {
        "frame": "the latest command at the frame",
        "next_frame": "the latest command before the following frame",
    }[config.action.when]
    return f"{when}, from {', '.join(dict.fromkeys(topics))}"
