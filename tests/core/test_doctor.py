import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from codediffuser import doctor_checks
from codediffuser.doctor import CHECKS, Check, CheckResult, run_checks
from codediffuser.doctor_checks import mesa_version, run_probe
from codediffuser.errors import SetupError


def failing(error: BaseException) -> Callable[[], str]:
    def probe() -> str:
        raise error

    return probe


def check(probe: Callable[[], str]) -> Check:
    return Check("thing", probe, lambda: "apt-get install thing")


def test_what_works_is_told_without_a_remedy() -> None:
    assert list(run_checks([check(lambda: "thing 1.2")])) == [
        CheckResult("thing", ok=True, detail="thing 1.2", remedy="", required=True)
    ]


def test_what_fails_is_told_with_its_remedy() -> None:
    assert list(run_checks([check(failing(SetupError("no thing")))])) == [
        CheckResult(
            "thing", ok=False, detail="no thing", remedy="apt-get install thing", required=True
        )
    ]


def test_a_failure_does_not_hide_the_checks_after_it() -> None:
    results = list(run_checks([check(failing(ImportError())), check(lambda: "fine")]))
    assert [result.ok for result in results] == [False, True]
    assert results[0].detail == "ImportError"


def test_results_come_one_by_one() -> None:
    results = run_checks([check(lambda: "fine"), check(failing(KeyboardInterrupt()))])
    assert next(results).ok
    with pytest.raises(KeyboardInterrupt):
        next(results)


def test_a_crash_in_a_probe_is_a_finding_and_what_it_said_before_is_kept() -> None:
    answers, failure = run_probe(
        "-c",
        "import os, signal; print('{\"devices\": 1}', flush=True);"
        f"os.kill(os.getpid(), {int(signal.SIGSEGV)})",
    )
    assert answers == {"devices": 1}
    assert failure == "crashed with SIGSEGV"


def test_a_probe_that_hangs_is_ended() -> None:
    answers, failure = run_probe("-c", "import time; time.sleep(60)", timeout_s=0.5)
    assert answers == {}
    assert failure.startswith("no answer within")


def test_a_probe_that_raises_is_told_by_its_last_line() -> None:
    assert run_probe("-c", "import no_such_module")[1] == (
        "ModuleNotFoundError: No module named 'no_such_module'"
    )


@pytest.mark.parametrize(
    ("driver", "version"),
    [
        ("Mesa 25.0.7-2~bpo12+1 (LLVM 15.0.6)", (25, 0)),
        ("Mesa 24.3.0", (24, 3)),
        ("535.183.01", None),
    ],
)
def test_mesa_tells_its_version(driver: str, version: tuple[int, int] | None) -> None:
    assert mesa_version(driver) == version


def rendering_that_answers(
    monkeypatch: pytest.MonkeyPatch, driver: str, failure: str = "", middle: object = (0.8, 0, 0)
) -> None:
    device = {"name": "llvmpipe", "driver": driver, "is_lavapipe": driver.startswith("Mesa")}
    answers = {"devices": [device], "middle_rgb": middle}
    monkeypatch.setattr(doctor_checks, "run_probe", lambda *_: (answers, failure))


def test_an_old_mesa_is_named_as_the_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    rendering_that_answers(monkeypatch, "Mesa 22.3.6", failure="crashed with SIGSEGV")
    with pytest.raises(SetupError, match=r"llvmpipe, Mesa 22\.3\.6: older than Mesa 24\.3"):
        doctor_checks.render_frame()


def test_a_driver_that_crashes_is_named_with_its_device(monkeypatch: pytest.MonkeyPatch) -> None:
    rendering_that_answers(monkeypatch, "535.183.01", failure="crashed with SIGSEGV")
    with pytest.raises(SetupError, match=r"llvmpipe, 535\.183\.01: crashed with SIGSEGV"):
        doctor_checks.render_frame()


def test_a_wrong_picture_is_no_success(monkeypatch: pytest.MonkeyPatch) -> None:
    rendering_that_answers(monkeypatch, "Mesa 25.0.7", middle=(0.5, 0.5, 0.5))
    with pytest.raises(SetupError, match=r"a red box came out as \(0\.50, 0\.50, 0\.50\)"):
        doctor_checks.render_frame()


@pytest.mark.sim
def test_a_frame_is_rendered_here() -> None:
    assert doctor_checks.render_frame().startswith("one frame on ")


def test_a_video_is_encoded_and_decoded_here() -> None:
    assert "H.264 both ways" in doctor_checks.encode_video()


def test_the_sandbox_cuts_a_loop_off_here() -> None:
    assert "endless loop cut off" in doctor_checks.run_sandbox()


def test_a_sandbox_that_lets_a_loop_run_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    import pydantic_monty

    def let_it_run(session: object, code: str) -> int | None:
        return 2 if code == "1 + 1" else None

    monkeypatch.setattr(pydantic_monty.MontySession, "feed_run", let_it_run)
    with pytest.raises(SetupError, match="came to an end"):
        doctor_checks.run_sandbox()


def test_opencv_here_is_headless() -> None:
    assert doctor_checks.headless_opencv().endswith("headless")


def test_opencv_with_windows_is_mended_by_the_headless_files(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import cv2

    monkeypatch.setattr(cv2, "getBuildInformation", lambda: "  GUI:      QT5\n")
    (result,) = run_checks([c for c in CHECKS if c.name == "opencv"])
    assert not result.ok
    assert "--force-reinstall --no-deps opencv-python-headless==" in result.remedy


def test_a_full_disk_is_told_with_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    usage = type("Usage", (), {"free": 1.5e9})
    monkeypatch.setattr(doctor_checks.shutil, "disk_usage", lambda _: usage)
    with pytest.raises(SetupError, match=r"1\.5 GB free here, a run needs 3 GB"):
        doctor_checks.free_disk()


def test_a_cache_that_does_not_exist_yet_is_not_created(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CODEDIFFUSER_CACHE", str(tmp_path / "deep" / "cache"))
    assert doctor_checks.write_cache() == str(tmp_path / "deep" / "cache")
    assert list(tmp_path.iterdir()) == []


def test_a_cache_that_is_a_file_is_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cache").touch()
    monkeypatch.setenv("CODEDIFFUSER_CACHE", str(tmp_path / "cache"))
    (result,) = run_checks([c for c in CHECKS if c.name == "cache folder"])
    assert not result.ok
    assert result.remedy.startswith("export CODEDIFFUSER_CACHE=")


def test_a_missing_browser_is_told_but_not_required(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    (result,) = run_checks([c for c in CHECKS if c.name == "browser"])
    assert not result.ok
    assert not result.required


def test_a_missing_plugin_is_mended_from_the_checkout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_checks, "PLUGIN", "lerobot_policy_of_nobody")
    (result,) = run_checks([c for c in CHECKS if c.name == "lerobot plugin"])
    assert result.detail == "the distribution lerobot_policy_of_nobody is not installed"
    assert "pip install --no-deps -e" in result.remedy


@pytest.mark.parametrize("each", CHECKS, ids=lambda c: c.name)
def test_every_check_has_a_command_that_mends_it(each: Check) -> None:
    words = each.remedy().split()
    assert words[0] in {"sudo", "export", "codediffuser"} or words[1:3] == ["-m", "pip"]
