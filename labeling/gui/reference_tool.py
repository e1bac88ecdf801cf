"""Reference mode of one tab: a click in a picture keeps the feature of that pixel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from codediffuser.errors import LabelError
from codediffuser.labeling.gui.episode_scene import EpisodeScene
from codediffuser.labeling.gui.reference_book import ReferenceBook
from codediffuser.labeling.gui.stage import Stage
from codediffuser.labeling.gui.texts import reference_line
from codediffuser.labeling.perception.references import BACKGROUND

BACKGROUND_RGB = (230, 30, 30)
CATEGORY_RGB = (40, 220, 255)


class ReferenceTool:
    """What the mode shows and does; off until `toggle`.

    Args:
        show_line: Puts a line of HTML into the panel.
        stage: Where pictures are clicked.
        book: Where references go; None for a server without a feature backend.
        operator: Who makes them.
    """

    def __init__(
        self,
        show_line: Callable[[str], None],
        stage: Stage,
        book: ReferenceBook | None,
        operator: str,
    ) -> None:
        self.active = False
        self._stage, self._book, self._operator = stage, book, operator
        self._turn = 0
        self._show_line = show_line

    def toggle(self, scene: EpisodeScene | None) -> None:
        """Begin or end the mode.

        Raises:
            LabelError: The server has no feature backend, or there is no picture.
        """
        if self._book is None:
            raise LabelError(
                "reference mode needs a feature backend: start the server with --features NAME"
            )
        if not self.active and (scene is None or not scene.cameras):
            raise LabelError(
                "reference mode needs a picture, and no camera of this episode has one"
            )
        self.active = not self.active
        if self.active and self._stage.photo is None:
            self._stage.switch("camera", ())
        self.refresh(scene)

    def next_category(self, scene: EpisodeScene | None) -> None:
        """Choose what the next click stands for."""
        self._turn += 1
        self.refresh(scene)

    def click(self, scene: EpisodeScene, origin: np.ndarray, direction: np.ndarray) -> str:
        """Keep the pixel that a ray (3,), (3,) hits; returns what to say.

        Raises:
            LabelError: No picture is shown, or the click lies beside it.
            CodeDiffuserError: The backend or the library file cannot be used.
        """
        photo = self._stage.photo
        if photo is None or photo.plane is None or self._book is None:
            raise LabelError("references are clicked in a picture: press C")
        column, row = np.floor(photo.plane.from_ray(origin, direction) + 0.5).astype(int)
        category = self._category(scene)
        self._book.add(scene, photo.camera, (int(column), int(row)), category, self._operator)
        self.refresh(scene)
        return f"{category}: pixel ({column}, {row}) of {photo.camera}"

    def undo(self, scene: EpisodeScene | None) -> str:
        """Take back this operator's last reference; returns what to say."""
        assert self._book is not None
        gone = self._book.remove_last(self._operator)
        self.refresh(scene)
        return f"took back {gone.category} at {gone.pixel} of {gone.camera}, {gone.episode}"

    def refresh(self, scene: EpisodeScene | None) -> None:
        """Show the library, and the marks of the picture."""
        photo = self._stage.photo
        if not self.active or scene is None or self._book is None:
            self._show_line("")
            if photo is not None:
                photo.mark(np.zeros((0, 2)), np.zeros((0, 3), np.uint8))
            return
        categories = self._book.categories(scene)
        library = self._book.read()
        self._show_line(
            reference_line(library, self._book.backend, categories, self._category(scene))
        )
        if photo is not None:
            marked = self._book.marked(scene, photo.camera)
            colors = [BACKGROUND_RGB if r.category == BACKGROUND else CATEGORY_RGB for r in marked]
            photo.mark(
                np.array([r.pixel for r in marked], dtype=float).reshape(-1, 2),
                np.array(colors, dtype=np.uint8).reshape(-1, 3),
            )

    def _category(self, scene: EpisodeScene) -> str:
        assert self._book is not None
        categories = self._book.categories(scene)
        return categories[self._turn % len(categories)]
