import importlib.metadata
import platform

import pytest

from codediffuser import manifest


def test_versions_name_python_and_every_package_that_could_change_results() -> None:
    found = manifest.versions()
    assert found["python"] == platform.python_version()
    assert found["numpy"] == importlib.metadata.version("numpy")
    assert set(found) == {"python", *manifest.PACKAGES}


def test_a_package_that_is_not_installed_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(manifest, "PACKAGES", ("no-such-distribution",))
    manifest.versions.cache_clear()
    try:
        assert manifest.versions()["no-such-distribution"] == "not installed"
    finally:
        manifest.versions.cache_clear()


def test_the_commit_is_a_hash_of_this_repository_or_unknown() -> None:
    commit = manifest.git_commit()
    assert commit == "unknown" or len(commit.split("-")[0]) >= 7


def test_without_git_the_commit_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    manifest.git_commit.cache_clear()
    try:
        assert manifest.git_commit() == "unknown"
    finally:
        manifest.git_commit.cache_clear()
