"""`codediffuser inspect`: pictures, curves and films of what a command wrote."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import tyro

from codediffuser.errors import ConfigError
from codediffuser.verbs.verb import Verb, track


@dataclass(frozen=True, slots=True)
class Kind:
    """Something that can be looked at."""

    name: str
    """What it is called in messages."""
    recognises: Callable[[Path], bool]
    """Whether a path is one."""
    default_out: Callable[[Path], Path]
    """Where its pictures go unless told otherwise."""
    inspect: Callable[[Path, Path], Iterator[Path]]
    """Writes pictures of a path to a folder and yields each."""
    files: int
    """How many it writes, for the progress bar."""


def _is_episode(path: Path) -> bool:
    from codediffuser.datagen.episode_format import MANIFEST

    return (path / MANIFEST).is_file()


def _episode_out(path: Path) -> Path:
    """`RUN/inspect/<id>`: an episode folder holds nothing but the episode."""
    return path.resolve().parent.parent / "inspect" / path.resolve().name


def _inspect_episode(path: Path, out: Path) -> Iterator[Path]:
    from codediffuser.datagen.inspect_episode import inspect_episode

    return inspect_episode(path, out)


KINDS = (Kind("episode", _is_episode, _episode_out, _inspect_episode, files=3),)
"""In the order in which they are tried."""


@dataclass(kw_only=True)
class Inspect(Verb):
    """Look at an episode: contact sheet over time and cameras, motion as curves, and a film.

    Example: codediffuser inspect runs/pack/episodes/000000
    """

    path: tyro.conf.Positional[Path]
    """Folder of an episode."""
    out: Path | None = None
    """Folder for what is drawn; RUN/inspect/<id> when left out."""

    def run(self) -> Path:
        """Draw and return the folder."""
        for kind in KINDS:
            if kind.recognises(self.path):
                out = self.out or kind.default_out(self.path)
                for _ in track(kind.inspect(self.path, out), "inspect", kind.files):
                    pass
                return out
        names = ", ".join(kind.name for kind in KINDS)
        raise ConfigError(f"{self.path}: nothing here that can be looked at; expected: {names}")
