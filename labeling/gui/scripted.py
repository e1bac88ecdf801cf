"""A scripted operator: drives the window in a real browser, for tests, measurements and pictures.

It does what a person does, mouse and keys, and knows from elsewhere which instances are meant.
Needs Playwright and a Chromium browser; nothing else of the toolkit does.
"""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from codediffuser.errors import SetupError
from codediffuser.labeling.gui.episode_scene import EpisodeScene
from codediffuser.labeling.gui.planes import PicturePlane, TopPlane, project_to_screen

CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = (
    "--headless=new", "--no-sandbox", "--disable-gpu-sandbox", "--use-gl=angle",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
)  # fmt: skip
"""Software rendering: the same pictures on a machine without a graphics card."""

WAIT_MS = 120_000


def find_chromium() -> str:
    """Path of a Chromium browser.

    Raises:
        SetupError: There is none.
    """
    for name in CHROMIUM:
        if found := shutil.which(name):
            return found
    raise SetupError(f"no browser: expected one of {', '.join(CHROMIUM)} on the path")


@contextlib.contextmanager
def open_browser(width: int = 1280, height: int = 800) -> Iterator[Any]:
    """Yield a Playwright browser context; each page of it is one tab.

    Raises:
        SetupError: Playwright or the browser is missing.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise SetupError(f"{error}; install codediffuser[dev]") from None
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=find_chromium(), args=list(ARGUMENTS)
        )  # fmt: skip
        context = browser.new_context(viewport={"width": width, "height": height})
        context.set_default_timeout(WAIT_MS)
        yield context
        browser.close()


class ScriptedOperator:
    """One tab of the labeling window.

    Args:
        context: What `open_browser` yields.
        url: Address of the server.
    """

    def __init__(self, context: Any, url: str) -> None:
        self.page = context.new_page()
        self._url = f"{url}?fixedDpr=1"
        self.load()

    def load(self) -> None:
        """Load the page, or load it again, and wait until an episode is shown."""
        self.page.goto(self._url)
        self.page.wait_for_selector("[data-saved]")
        # viser warns of software rendering in a note that lies over the view and swallows clicks.
        self.page.add_style_tag(content=".mantine-Notification-root { display: none }")

    def text(self) -> str:
        """Everything that the page says."""
        return str(self.page.inner_text("body"))

    def episode(self) -> str:
        """Id of the episode that is shown."""
        return str(self.page.get_attribute("[data-episode]", "data-episode"))

    def chosen(self) -> tuple[str, ...]:
        """Ids that the page says are selected."""
        return tuple(str(self.page.get_attribute("[data-episode]", "data-chosen")).split())

    def press(self, key: str) -> None:
        """Press a key of the window."""
        self.page.keyboard.press(key)

    def wait_for_chosen(self, *names: str) -> None:
        """Wait until just these are selected, in this order, and on disk."""
        self._wait(f'[data-chosen="{" ".join(names)}"]')
        self._wait('[data-saved]:not([data-saved="saving"])')

    def wait_for_other(self, episode: str) -> None:
        """Wait until another episode than this is shown."""
        self._wait(f'[data-episode]:not([data-episode="{episode}"])')

    def open_episode(self, name: str) -> None:
        """Ask for an episode by its id."""
        # viser's labels name no field: it is the first one after its label.
        label = self.page.locator('label:text-is("go to")')
        label.locator("xpath=following::input[1]").fill(name)
        self.page.get_by_role("button", name="Open", exact=True).click()

    def wait_for_episode(self, name: str) -> None:
        """Wait until this episode is shown."""
        self._wait(f'[data-episode="{name}"]')

    def wait_for_submitted(self) -> None:
        """Wait until the selection is saved as labels."""
        self._wait('[data-saved="labels"]')

    def wait_for_references(self, **counts: int) -> None:
        """Wait until reference mode says that it has just so many of each category."""
        said = " ".join(f"{category}:{count}" for category, count in counts.items())
        self._wait(f'[data-references="{said}"]')

    def wait_for(self, text: str) -> None:
        """Wait until the page says something."""
        self.page.get_by_text(text).first.wait_for()

    def _wait(self, selector: str) -> None:
        self.page.wait_for_selector(selector, state="attached")

    def spot(self, scene: EpisodeScene, instance_id: str, view: str = "top") -> tuple[float, float]:
        """Where in the page an instance's nearest point to its middle is, in pixels.

        Args:
            scene: The episode that is shown.
            instance_id: Which instance.
            view: `top`, or the camera that is shown.
        """
        picker = scene.top if view == "top" else scene.through(view)
        number = [i.id for i in scene.instances].index(instance_id)
        points = picker.points[picker.owner == number]
        middle = points.mean(axis=0)
        aim = points[np.argmin(np.linalg.norm(points - middle, axis=1))]
        return self.place(scene, aim, view)

    def place(self, scene: EpisodeScene, at: np.ndarray, view: str = "top") -> tuple[float, float]:
        """Where in the page a point (2,) of a view's plane is, in pixels, in an unmoved view."""
        box = self.canvas()
        aspect = box["width"] / box["height"]
        plane: TopPlane | PicturePlane
        if view == "top":
            assert scene.task is not None
            workspace = scene.task.config.workspace
            plane = TopPlane.around(
                scene.instances, np.array(workspace.low_m), np.array(workspace.high_m)
            )
        else:
            plane = PicturePlane(scene.cameras[view])
        world = plane.to_world(np.asarray(at, dtype=np.float64)[None])[0]
        x, y = project_to_screen(world, plane.viewpoint(aspect), aspect)
        return box["x"] + x * box["width"], box["y"] + y * box["height"]

    def canvas(self) -> dict[str, float]:
        """Where the view is in the page, in pixels."""
        box: dict[str, float] = self.page.locator("canvas").last.bounding_box()
        return box

    def click(self, at: tuple[float, float]) -> None:
        """Click at a place of the page."""
        self.page.mouse.click(*at)

    def hover(self, at: tuple[float, float]) -> None:
        """Move the mouse to a place of the page."""
        self.page.mouse.move(*at)

    def screenshot(self) -> bytes:
        """PNG of the page."""
        return bytes(self.page.screenshot())

    def until(
        self, condition: Callable[[], bool], what: str, timeout_s: float = WAIT_MS / 1000
    ) -> None:
        """Wait until a condition holds.

        Raises:
            TimeoutError: It does not; `what` names it.
        """
        end = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f"the page does not say {what} within {timeout_s:.0f} s")
            time.sleep(0.03)
