"""What an export format does, and the options that all of them share."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Literal

from pydantic import Field

from codediffuser.datagen.episode_format import EpisodeManifest
from codediffuser.datasets.clouds import CloudConfig
from codediffuser.datasets.export_meta import OTHER_DOCUMENT, export_fingerprint
from codediffuser.datasets.exporting.part import Part
from codediffuser.datasets.exporting.source import Source
from codediffuser.datasets.exporting.video import VideoConfig
from codediffuser.errors import ConfigError, DatasetError
from codediffuser.labeling.attention_2d import DILATION_PX
from codediffuser.registry import Registry, unknown_name
from codediffuser.schema import Strict

Profile = Literal["pointcloud", "portable", "masked-rgb"]


class ExportOptions(Strict):
    """What goes into an export."""

    profile: Profile = "pointcloud"
    """`pointcloud`: clouds with attention. `portable`: every picture, with depth, masks and
    calibration. `masked-rgb`: colour where attention is, black elsewhere. All have state and
    action."""
    cloud: CloudConfig = CloudConfig()
    video: VideoConfig = VideoConfig()
    dilation_px: int = Field(default=DILATION_PX, ge=0)
    """How far attention reaches around a labelled point on a picture."""

    @property
    def needs_labels(self) -> bool:
        """Whether episodes without labels cannot be exported."""
        return self.profile != "portable"


@dataclass(frozen=True)
class ExportFormat(ABC):
    """One target of `convert --to`. Instances travel to worker processes."""

    options: ExportOptions
    labelled: bool
    """Whether the episodes have labels; false only for unlabelled runs that need none."""

    NAME: ClassVar[str]
    PROFILES: ClassVar[tuple[Profile, ...]]
    """Profiles that the format can hold; the first is its default."""
    DOCUMENT: ClassVar[str] = OTHER_DOCUMENT
    """Where in the export our own description lies."""

    @classmethod
    def default_out(cls, run: Path, profile: str) -> Path:
        """Folder of the export unless another is asked for."""
        return run / "exports" / f"{cls.NAME}-{profile}"

    def fingerprint(self, root: Path) -> str:
        """SHA-256 of an export's files, without our own document and card."""
        return export_fingerprint(root)

    @property
    def relevant_options(self) -> dict[str, Any]:
        """What of the options decides the bytes of a part."""
        options = self.options
        relevant: dict[str, Any] = {"format": self.NAME, "profile": options.profile}
        if options.profile == "pointcloud":
            relevant["cloud"] = options.cloud.model_dump(mode="json")
        else:
            relevant["dilation_px"] = options.dilation_px
        return relevant

    @abstractmethod
    def modules(self) -> tuple[ModuleType, ...]:
        """The code that decides the bytes of a part."""

    @abstractmethod
    def make(self, source: Source, folder: Path) -> None:
        """Write the part of one episode into an empty folder.

        Raises:
            CodeDiffuserError: The episode cannot become a part of this export.
        """

    @abstractmethod
    def assemble(
        self, root: Path, parts: Sequence[Part], manifests: Sequence[EpisodeManifest]
    ) -> None:
        """Write the export into an empty folder.

        Args:
            root: The folder.
            parts: Whole parts, in order of episodes.
            manifests: Of the same episodes.

        Raises:
            DatasetError: The episodes do not fit together.
        """

    def recover(self, previous: Path, index: int, folder: Path) -> bool:
        """Take the part of one episode out of an earlier export.

        Args:
            previous: An export of this format whose bytes were checked.
            index: The episode's number there.
            folder: Empty folder to write the part to.

        Returns:
            Whether the part is there now, equal to what `make` would have written.
        """
        return False


FORMATS: Registry[type[ExportFormat]] = Registry("export format")


def format_for(to: str, profile: str | None) -> tuple[type[ExportFormat], Profile]:
    """Look up a format and a profile that it can hold; None takes the format's default.

    Raises:
        NotRegisteredError: No such format.
        ConfigError: The format cannot hold the profile.
    """
    importlib.import_module("codediffuser.datasets.exporting.formats")
    kind = FORMATS.get(to)
    for known in kind.PROFILES:
        if profile in (None, known):
            return kind, known
    raise ConfigError(f"--to {to}: " + unknown_name("profile", str(profile), list(kind.PROFILES)))


def same_for_all(manifests: Sequence[EpisodeManifest], what: str, values: Sequence[Any]) -> Any:
    """The one value that all episodes share.

    Raises:
        DatasetError: They do not; the message names two that differ.
    """
    for manifest, value in zip(manifests, values, strict=True):
        if value != values[0]:
            raise DatasetError(
                f"episodes of one dataset need the same {what}: {manifests[0].id} has "
                f"{values[0]}, {manifest.id} has {value}; export them from separate runs"
            )
    return values[0]
