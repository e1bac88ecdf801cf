"""Pictures of a whole set of scenes: `overlay.png`, `sheet.pdf` and `pads.pdf` beside them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from codediffuser.datagen.drawing import Drawing, Shape
from codediffuser.datagen.scene import SceneSpec
from codediffuser.datagen.sheets.contact_sheet import contact_sheet
from codediffuser.datagen.sheets.overlay import overlay_png
from codediffuser.datagen.sheets.pads_pdf import Paper, pads_pdf
from codediffuser.datagen.task import Task
from codediffuser.files import write_bytes

OVERLAY, SHEET, PADS = "overlay.png", "sheet.pdf", "pads.pdf"


@dataclass(slots=True)
class SetPictures:
    """Collects the scenes of a set as they are drawn, then writes its pictures.

    Scenes are kept as drawings that share what is alike in all of them, about 10 KB each.
    """

    task: Task
    variant: str
    seed: int
    paper: Paper = "A4"
    """What `pads.pdf` is printed on."""
    _drawings: list[Drawing] = field(default_factory=list)
    _pool: dict[Shape, Shape] = field(default_factory=dict)

    def add(self, scene: SceneSpec) -> None:
        """Take the next scene in."""
        drawing = self.task.draw_reset(scene)
        panels = tuple(
            replace(panel, shapes=tuple(self._pool.setdefault(s, s) for s in panel.shapes))
            for panel in drawing.panels
        )
        self._drawings.append(replace(drawing, panels=panels))

    def save(self, out: Path) -> list[Path]:
        """Write the three files, each whole or not at all, and return their paths.

        Raises:
            ConfigError: No scene was taken in.
        """
        names = (self.task.name, self.variant, f"seed {self.seed}")
        files = {
            OVERLAY: overlay_png(self._drawings, names),
            SHEET: contact_sheet(self._drawings, " · ".join(names)),
            PADS: pads_pdf(self.task, self.variant, self.paper),
        }
        for name, data in files.items():
            write_bytes(out / name, data)
        return [out / name for name in files]
