"""`codediffuser label`: which object and which place each demonstration attends to."""

from __future__ import annotations

import getpass
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from codediffuser.errors import ConfigError, LabelError
from codediffuser.verbs.verb import Verb, console, track

if TYPE_CHECKING:
    from codediffuser.labeling.gui.reference_book import ReferenceBook
    from codediffuser.labeling.instances import InstanceSource

TOKEN_VARIABLE = "CODEDIFFUSER_LABEL_TOKEN"


@dataclass(kw_only=True)
class Label(Verb):
    """Label the attention of every episode in RUN/episodes, in the browser.

    Example: codediffuser label runs/pack
    Example: codediffuser label runs/pack --auto --workers 2
    """

    run_folder: tyro.conf.Positional[Path]
    """Run folder with episodes/."""
    auto: bool = False
    """Label the logged targets of simulated episodes by --source; no browser."""
    workers: int = 1
    """Processes of --auto."""
    overwrite: bool = False
    """--auto replaces labels that are there by a new revision; the history is kept."""
    report: bool = False
    """Count labels, compare labelers and draw where they disagree, into RUN/labeling/report."""
    export: Path | None = None
    """Write all labels of the run with their history into one JSONL file."""
    merge: Path | None = None
    """Merge the labels of a file that --export wrote into the run."""
    operator: str | None = None
    """Name that is stored with the labels; the login name unless the browser knows another."""
    source: str = "oracle"
    """Who finds the instances to choose from: oracle (the simulator), features (the built-in
    network), or references (the library of --references, with the backend of --features)."""
    prelabel: Literal["ground truth", "features", "language"] | None = None
    """Begin every episode with a proposal to accept or correct."""
    features: str | None = None
    """Backend whose reference features are collected by clicking in pictures (key I): dinov2."""
    weights: Path | None = None
    """Weights of that backend; its own place when left out."""
    references: Path | None = None
    """Library file of the references; RUN/labeling/references/BACKEND.json when left out."""
    host: str = "127.0.0.1"
    """Address to serve at. Any but this machine's requires a token, see the error message."""
    port: int = 8080
    """Port; the next free one is taken when it is busy."""

    def run(self) -> Path | str:
        """Do what was asked and return where the result lies."""
        chosen = [self.auto, self.report, self.export is not None, self.merge is not None]
        if sum(chosen) > 1:
            raise ConfigError("choose one of --auto, --report, --export and --merge")
        if self.auto:
            return self._label_automatically()
        if self.report:
            return self._report()
        if self.export is not None:
            return self._export(self.export)
        if self.merge is not None:
            return self._merge(self.merge)
        return self._serve()

    def _serve(self) -> str:
        from codediffuser.labeling.gui.access import check_access
        from codediffuser.labeling.gui.app import LabelApp
        from codediffuser.labeling.gui.desk import Desk

        token = os.environ.get(TOKEN_VARIABLE)
        check_access(self.host, token)
        desk = Desk(
            self.run_folder,
            source=self._instance_source(),
            prelabel=self.prelabel,
            references=self._reference_book(),
        )
        name = self.operator or getpass.getuser()
        app = LabelApp(desk, operator=name, host=self.host, port=self.port, token=token)
        console.print(f"Labeling {self.run_folder} at {app.url}; stop with Ctrl+C", markup=False)
        if token is not None:
            console.print(
                f"Operators need the token in {TOKEN_VARIABLE}. What passes over the network is "
                "not encrypted: prefer an ssh tunnel."
            )
        try:
            while True:
                time.sleep(1.0)
        except KeyboardInterrupt:
            app.close()
        return str(self.run_folder / "episodes")

    def _reference_book(self) -> ReferenceBook | None:
        from codediffuser.labeling.gui.reference_book import ReferenceBook
        from codediffuser.labeling.perception.features import FeatureOptions, check_backend

        if self.features is None:
            if self.weights is not None or self.references is not None:
                raise ConfigError("--weights and --references need --features NAME")
            return None
        check_backend(self.features)
        options = FeatureOptions(weights=self.weights)
        return ReferenceBook(self.features, self._library_path(self.features), options)

    def _instance_source(self) -> str | InstanceSource:
        if self.source != "references":
            return self.source
        from codediffuser.labeling.perception.features import FeatureOptions
        from codediffuser.labeling.perception.library_source import LibrarySource

        if self.features is None:
            raise ConfigError(
                "--source references needs --features NAME, whose references it reads"
            )
        options = FeatureOptions(weights=self.weights)
        return LibrarySource(self.features, self._library_path(self.features), options)

    def _library_path(self, backend: str) -> Path:
        own = self.run_folder / "labeling" / "references" / f"{backend}.json"
        return self.references or own

    def _label_automatically(self) -> Path:
        from codediffuser.datagen.episode import list_episodes
        from codediffuser.labeling.auto import label_run

        results = label_run(
            self.run_folder, workers=self.workers, overwrite=self.overwrite, source=self.source
        )
        errors = []
        for result in track(results, "label", len(list_episodes(self.run_folder))):
            if result.error:
                errors.append(f"{result.episode_id}: {result.error}")
        for line in errors:
            console.print(line, markup=False)
        if errors:
            raise LabelError(f"{len(errors)} episodes got no labels; the first: {errors[0]}")
        return self.run_folder / "episodes"

    def _report(self) -> Path:
        from codediffuser.labeling.report import report_text, write_report

        report, path = write_report(self.run_folder)
        console.print(report_text(report), markup=False)
        return path

    def _export(self, path: Path) -> Path:
        from codediffuser.labeling.exchange import export_labels

        console.print(f"{export_labels(self.run_folder, path)} episodes", markup=False)
        return path

    def _merge(self, path: Path) -> Path:
        from codediffuser.labeling.exchange import import_labels

        left = []
        for result in import_labels(self.run_folder, path):
            console.print(f"{result.episode_id}: {result.outcome} {result.message}", markup=False)
            if result.outcome in ("conflict", "error"):
                left.append(result.episode_id)
        if left:
            raise LabelError(
                f"{len(left)} episodes were left as they are, the first: {left[0]}; open them "
                "with `codediffuser label RUN` and decide there"
            )
        return self.run_folder / "episodes"
