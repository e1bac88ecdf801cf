"""The single checks of `codediffuser doctor`, each with the command that mends what it finds.

A check returns what it found and raises when the thing does not work. None of them changes the
machine.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.metadata
import importlib.util
import io
import json
import os
import platform
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from codediffuser.errors import SetupError
from codediffuser.files import cache_folder

MIN_MESA = (24, 3)
"""Older lavapipe lacks `VK_KHR_external_semaphore_fd`, and SAPIEN then finds no device."""

MIN_FREE_GB = 3.0
"""A quickstart run takes about one; the rest is room for checkpoints and videos."""

PLUGIN = "lerobot_policy_codediffuser"
"""LeRobot loads distributions whose metadata name begins with `lerobot_policy_`, hyphens aside."""

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
PROBE_TIMEOUT_S = 120.0
SANDBOX_LIMIT_S = 0.2


def render_frame() -> str:
    """Render one frame with SAPIEN in a process of its own."""
    answers, failure = run_probe("-m", "codediffuser.datagen.render_probe")
    devices = answers.get("devices", [])
    seen = "; ".join(f"{d['name']}, {d['driver']}" for d in devices) or "no Vulkan device"
    for device in devices:
        version = mesa_version(device["driver"])
        if device["is_lavapipe"] and version is not None and version < MIN_MESA:
            raise SetupError(f"{seen}: older than Mesa {MIN_MESA[0]}.{MIN_MESA[1]}")
    if failure:
        raise SetupError(f"{seen}: {failure}")
    red, green, blue = answers["middle_rgb"]
    if not red > 2 * max(green, blue):
        raise SetupError(f"{seen}: a red box came out as ({red:.2f}, {green:.2f}, {blue:.2f})")
    return f"one frame on {seen}"


def mend_rendering() -> str:
    """SAPIEN when it is missing, else a Vulkan loader and a Mesa that is new enough."""
    if importlib.util.find_spec("sapien") is None:
        return reinstall("sapien")
    release = ""
    with contextlib.suppress(OSError):  # systems without /etc/os-release
        release = platform.freedesktop_os_release().get("VERSION_CODENAME", "")
    # Debian 12 has the newer Mesa in its backports only.
    option = "-t bookworm-backports " if release == "bookworm" else ""
    return system_remedy(f"{option}libvulkan1 mesa-vulkan-drivers")


def headless_opencv() -> str:
    """Import OpenCV and see that it is the build without windows.

    SAPIEN asks for `opencv-python`, LeRobot for `opencv-python-headless`; both write into one
    folder, and the one with windows needs libraries that a server lacks.
    """
    cv2 = importlib.import_module("cv2")
    if not re.search(r"GUI:\s+NONE", cv2.getBuildInformation()):
        raise SetupError(f"cv2 {cv2.__version__} is the build with windows")
    return f"cv2 {cv2.__version__}, headless"


def mend_opencv() -> str:
    """Lay the headless files over the others again."""
    return reinstall("opencv-python-headless")


def encode_video() -> str:
    """Encode four frames as H.264 in memory and decode them again."""
    av = importlib.import_module("av")
    frames = [np.full((48, 64, 3), 60 * i, dtype=np.uint8) for i in range(4)]
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("h264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for rgb in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
        container.mux(stream.encode())
        codec = stream.codec_context.codec.name
    file.seek(0)
    with av.open(file) as container:
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    errors = [abs(float(a.mean()) - float(b.mean())) for a, b in zip(frames, decoded, strict=True)]
    if max(errors) > 8:
        raise SetupError(f"{codec}: decoded pictures differ by {max(errors):.0f} of 255")
    return f"H.264 both ways, {codec}, PyAV {av.__version__}"


def run_sandbox() -> str:
    """Run `1 + 1` in the sandbox, and see that it cuts an endless loop off."""
    monty = importlib.import_module("pydantic_monty")
    limits = {"max_feed_duration_secs": SANDBOX_LIMIT_S}
    with monty.Monty() as pool, pool.checkout(limits=limits) as session:
        if (answer := session.feed_run("1 + 1")) != 2:
            raise SetupError(f"1 + 1 gave {answer!r}")
        started = time.monotonic()
        try:
            session.feed_run("while True: pass")
        except monty.MontyRuntimeError as error:
            took_s = time.monotonic() - started
            if "TimeoutError" not in str(error):
                raise SetupError(f"an endless loop ended with: {error}") from None
            return f"pydantic-monty {monty.__version__}, endless loop cut off after {took_s:.2f} s"
    raise SetupError("an endless loop came to an end")


def torch_devices() -> str:
    """Add two numbers on every torch device, in a process of its own."""
    # The core imports no torch; the other process does.
    code = (
        "import json, torch\n"
        "names = ['cpu'] + [f'cuda:{i}' for i in range(torch.cuda.device_count())]\n"
        "assert all((torch.ones(2, device=n).sum() == 2).item() for n in names)\n"
        "print(json.dumps({'version': torch.__version__, 'names': names}))"
    )
    answers, failure = run_probe("-c", code)
    if failure:
        raise SetupError(failure)
    return f"torch {answers['version']}: {', '.join(answers['names'])}"


def import_plugin() -> str:
    """Let LeRobot load its third-party plugins as its commands do, and look for ours."""
    try:
        version = importlib.metadata.version(PLUGIN)
    except importlib.metadata.PackageNotFoundError:
        raise SetupError(f"the distribution {PLUGIN} is not installed") from None
    code = (
        "import json, sys\n"
        "from lerobot.utils.import_utils import register_third_party_plugins\n"
        "register_third_party_plugins()\n"
        f"print(json.dumps({{'loaded': {PLUGIN!r} in sys.modules}}))"
    )
    answers, failure = run_probe("-c", code)
    if failure or not answers["loaded"]:
        raise SetupError(failure or f"LeRobot does not load {PLUGIN}; is its metadata name so?")
    return f"{PLUGIN} {version}, loaded by LeRobot {importlib.metadata.version('lerobot')}"


def mend_plugin() -> str:
    """Install the companion distribution from the checkout."""
    folder = checkout() / "training" / "lerobot_plugin"
    return pip("install --no-deps -e", str(folder))


def write_cache() -> str:
    """Write a file in the cache folder, or in its nearest parent that exists."""
    folder = cache_folder()
    place = folder
    while not place.exists():
        place = place.parent
    with tempfile.NamedTemporaryFile(dir=place):
        return str(folder)


def mend_cache() -> str:
    """Another folder; ownership of this one is the user's affair."""
    return "export CODEDIFFUSER_CACHE=/a/folder/you/can/write"


def free_disk() -> str:
    """See that the present folder's disk has room for a run."""
    free_gb = shutil.disk_usage(Path.cwd()).free / 1e9
    if free_gb < MIN_FREE_GB:
        raise SetupError(f"{free_gb:.1f} GB free here, a run needs {MIN_FREE_GB:.0f} GB")
    return f"{free_gb:.0f} GB free here"


def mend_disk() -> str:
    """Another place for runs."""
    return "codediffuser VERB --out /a/larger/disk/RUN"


def start_browser() -> str:
    """Start Chromium far enough to tell its version; only tests of the GUI need it."""
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if found is None:
        raise SetupError(f"none of {', '.join(BROWSERS)} found; only tests need it")
    done = subprocess.run(
        [found, "--version"], capture_output=True, text=True, timeout=30, check=False
    )
    if done.returncode != 0:
        raise SetupError(f"{found}: {_failure(done.returncode, done.stderr)}")
    return done.stdout.strip()


def mend_browser() -> str:
    """Chromium from the distribution."""
    return system_remedy("chromium")


def run_probe(*arguments: str, timeout_s: float = PROBE_TIMEOUT_S) -> tuple[dict[str, Any], str]:
    """Run Python with these arguments and join the JSON objects that it prints, one a line.

    Returns:
        answers: All that was printed before the end, also when the end was a crash.
        failure: What went wrong in a few words, or an empty string.
    """
    command = [sys.executable, *arguments]
    # Many threads would only cost start-up.
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=timeout_s, check=False, env=environment
        )
        output, failure = done.stdout, _failure(done.returncode, done.stderr)
    except subprocess.TimeoutExpired as error:
        output = error.stdout.decode() if isinstance(error.stdout, bytes) else error.stdout or ""
        failure = f"no answer within {timeout_s:.0f} s"
    answers: dict[str, Any] = {}
    for line in output.splitlines():
        if line.startswith("{"):
            answers.update(json.loads(line))
    return answers, failure


def _failure(return_code: int, stderr: str) -> str:
    if return_code == 0:
        return ""
    if return_code < 0:
        return f"crashed with {signal.Signals(-return_code).name}"
    lines = [line for line in stderr.splitlines() if line.strip()]
    return lines[-1].strip() if lines else f"ended with code {return_code}"


def mesa_version(driver: str) -> tuple[int, int] | None:
    """Major and minor in words such as `Mesa 25.0.7-2 (LLVM 15)`; None when there are none."""
    found = re.search(r"Mesa (\d+)\.(\d+)", driver)
    return (int(found[1]), int(found[2])) if found else None


def checkout() -> Path:
    """Folder that holds the package: the repository's root, or `site-packages`."""
    return Path(__file__).resolve().parent.parent


def system_remedy(packages: str) -> str:
    """The set-up script of the checkout, else apt with these packages."""
    script = checkout() / "tools" / "setup.sh"
    if script.is_file():
        return f"sudo {shlex.quote(str(script))} system"
    return f"sudo apt-get install {packages}"


def reinstall(distribution: str) -> str:
    """Install one distribution's files anew, at the version that is there."""
    try:
        pinned = f"{distribution}=={importlib.metadata.version(distribution)}"
    except importlib.metadata.PackageNotFoundError:
        return pip("install", distribution)
    return pip("install --force-reinstall --no-deps", pinned)


def pip(action: str, what: str) -> str:
    """A pip command for the Python that runs this."""
    return f"{shlex.quote(sys.executable)} -m pip {action} {shlex.quote(what)}"
