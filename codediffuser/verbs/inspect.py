"""`codediffuser inspect`: episodes, runs and datasets, for people to look at."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from codediffuser.errors import ConfigError
from codediffuser.verbs.verb import Verb, console, track

if TYPE_CHECKING:
    from codediffuser.datasets.inspecting.episode_view import EpisodeView, Shelf
    from codediffuser.datasets.inspecting.survey import Motion, Survey


@dataclass(frozen=True, slots=True)
class Kind:
    """Something with episodes that can be looked at."""

    name: str
    """What it is called in messages."""
    recognises: Callable[[Path], bool]
    """Whether a path is one."""
    survey: Callable[[Path], Survey]
    """What there is to know of it without pictures."""
    motion: Callable[[Path], Motion | None]
    """State and actions for the report."""
    shelf: Callable[[Path], Shelf]
    """Its episodes for the viewers."""


def _is_episode(path: Path) -> bool:
    from codediffuser.datagen.episode_format import MANIFEST

    return (path / MANIFEST).is_file()


def _run_kind() -> Kind:
    from codediffuser.datagen.episode_format import EPISODES
    from codediffuser.datasets.inspecting.recorded_view import run_shelf
    from codediffuser.datasets.inspecting.run_survey import run_motion, survey_run

    return Kind("run", lambda p: (p / EPISODES).is_dir(), survey_run, run_motion, run_shelf)


def _dataset_kind() -> Kind:
    from codediffuser.datasets.export_meta import INFO
    from codediffuser.datasets.inspecting.dataset_survey import dataset_motion, survey_dataset
    from codediffuser.datasets.inspecting.dataset_view import dataset_shelf

    return Kind(
        "LeRobot dataset", lambda p: (p / INFO).is_file(), survey_dataset, dataset_motion,
        dataset_shelf,
    )  # fmt: skip


@dataclass(kw_only=True)
class Inspect(Verb):
    """Look at an episode, a run or a LeRobot dataset.

    Of an episode it draws a contact sheet, its motion as curves, and a film. Of a run or a dataset
    it prints a summary, or writes a report, or shows the episodes in a browser.

    Example: codediffuser inspect runs/pack --html pack.html
    """

    path: tyro.conf.Positional[Path]
    """Folder of an episode, a run or a LeRobot dataset."""
    out: Path | None = None
    """Folder for what is drawn of an episode; RUN/inspect/<id> when left out."""
    html: Path | None = None
    """Write a report with plots to this file."""
    rerun: Path | None = None
    """Write episodes to this .rrd file: `rerun FILE` shows them."""
    episodes: tuple[str, ...] = ()
    """Ids for --rerun, and the one that --serve shows first; the first episode when left out."""
    serve: bool = False
    """Show the episodes in a browser, on this machine alone, until Ctrl+C."""
    port: int = 8080
    """Of --serve; the next free one is taken when it is busy."""

    def run(self) -> Path | str:
        """Do what was asked for; a summary is returned when nothing else was."""
        if _is_episode(self.path):
            return self._inspect_episode()
        kinds = (_run_kind(), _dataset_kind())
        for kind in kinds:
            if kind.recognises(self.path):
                return self._inspect(kind)
        names = ", ".join(["episode", *(kind.name for kind in kinds)])
        raise ConfigError(f"{self.path}: nothing here that can be looked at; expected: {names}")

    def _inspect_episode(self) -> Path:
        from codediffuser.datagen.inspect_episode import inspect_episode
        from codediffuser.datasets.inspecting.recorded_view import RecordedView

        if self.html is not None:
            raise ConfigError(f"{self.path}: an episode; --html is for a run or a dataset")
        if self.rerun is not None:
            return self._write_rerun([RecordedView(self.path)], self.rerun)
        folder = self.path.resolve()
        if self.serve:
            return self._serve(_run_kind().shelf(folder.parent.parent), folder.name)
        # An episode folder holds nothing but the episode.
        out = self.out or folder.parent.parent / "inspect" / folder.name
        for _ in track(inspect_episode(self.path, out), "inspect", 3):
            pass
        return out

    def _inspect(self, kind: Kind) -> Path | str:
        from codediffuser.datasets.inspecting.html_report import write_html
        from codediffuser.datasets.inspecting.summary_text import summary_text

        if self.out is not None:
            raise ConfigError(f"{self.path}: a {kind.name}; --out is for an episode, see --html")
        result: Path | str | None = None
        if self.html is not None:
            console.print(f"reading {self.path}", markup=False)
            result = write_html(kind.survey(self.path), kind.motion(self.path), self.html)
        if self.rerun is not None or self.serve:
            shelf = kind.shelf(self.path)
            chosen = self._chosen(shelf)
            if self.rerun is not None:
                result = self._write_rerun([shelf.open(name) for name in chosen], self.rerun)
            if self.serve:
                result = self._serve(shelf, chosen[0])
        return result if result is not None else summary_text(kind.survey(self.path))

    def _chosen(self, shelf: Shelf) -> tuple[str, ...]:
        chosen = self.episodes or shelf.ids[:1]
        unknown = [name for name in chosen if name not in shelf.ids]
        if unknown or not chosen:
            raise ConfigError(
                f"{self.path}: no episode '{''.join(unknown[:1])}'; it has {len(shelf.ids)}, the "
                f"first are: {', '.join(shelf.ids[:5])}"
            )
        return chosen

    def _write_rerun(self, views: list[EpisodeView], path: Path) -> Path:
        from codediffuser.datasets.inspecting.rerun_file import write_rerun

        written: Iterator[str] = write_rerun(views, path)
        for _ in track(written, "rerun", len(views)):
            pass
        return path

    def _serve(self, shelf: Shelf, first: str) -> Path:
        from codediffuser.datasets.inspecting.app import InspectApp

        app = InspectApp(shelf, self.path.resolve().name, port=self.port, first=first)
        console.print(f"{self.path} at {app.url}; stop with Ctrl+C", markup=False)
        try:
            while True:
                time.sleep(1.0)
        except KeyboardInterrupt:
            app.close()
        return self.path
