"""Checks every requirement by using it, and knows the command that mends each.

`codediffuser doctor` prints what `run_checks` yields. Checks that load a graphics driver or torch
run in a process of their own: a driver that crashes is a finding here, not the end of the doctor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from codediffuser import doctor_checks as checks


@dataclass(frozen=True, slots=True)
class Check:
    """One requirement and how it is tried."""

    name: str
    probe: Callable[[], str]
    """Uses the thing and returns what it found; any exception means that it does not work."""
    remedy: Callable[[], str]
    """Gives the command that mends it."""
    required: bool = True
    """False for what only some need: the doctor reports it and still passes."""


@dataclass(frozen=True, slots=True)
class CheckResult:
    """What one check found."""

    name: str
    ok: bool
    detail: str
    """What was found, or what went wrong."""
    remedy: str
    """Command that mends it; empty when nothing is to mend."""
    required: bool


CHECKS: tuple[Check, ...] = (
    Check("rendering", checks.render_frame, checks.mend_rendering),
    Check("opencv", checks.headless_opencv, checks.mend_opencv),
    Check("video", checks.encode_video, lambda: checks.reinstall("av")),
    Check("sandbox", checks.run_sandbox, lambda: checks.reinstall("pydantic-monty")),
    Check("torch", checks.torch_devices, lambda: checks.reinstall("torch")),
    Check("lerobot plugin", checks.import_plugin, checks.mend_plugin),
    Check("cache folder", checks.write_cache, checks.mend_cache),
    Check("free disk", checks.free_disk, checks.mend_disk),
    Check("browser", checks.start_browser, checks.mend_browser, required=False),
)


def run_checks(which: Iterable[Check] = CHECKS) -> Iterator[CheckResult]:
    """Run the checks one after the other and yield each result as it comes."""
    for check in which:
        try:
            detail, ok = check.probe(), True
        except Exception as error:  # whatever a broken installation raises is the finding
            detail, ok = str(error) or type(error).__name__, False
        remedy = "" if ok else check.remedy()
        yield CheckResult(check.name, ok, detail, remedy, check.required)
