"""Collecting goes on where it stopped, loses nothing, and records every failure.

Simulator and processes are replaced by stand-ins; `test_record.py` has the real ones.
"""

import dataclasses
import json
import shutil

import pytest

from codediffuser.datagen import collect
from codediffuser.datagen.collect import CollectOptions
from codediffuser.datagen.demo_results import (
    DemoFailure,
    DemoResult,
    failure_path,
    report_lines,
    summarize,
)
from codediffuser.datagen.episode import load_manifest
from codediffuser.datagen.episode_check import check_episode
from codediffuser.datagen.workers import Outcome
from codediffuser.errors import ConfigError, EpisodeError
from codediffuser.files import sha256_file

IDS = ("000000", "000001", "000002")


class Stand:
    """A stand-in for the processes: it notes which scenes it was given, and can be told to fail."""

    def __init__(self, run, write):
        self.run, self.write = run, write
        self.given: list[str] = []
        self.expert_fails: set[str] = set()
        self.process_dies: set[str] = set()

    def run_tasks(self, function, jobs, **_):
        for job in jobs:
            self.given.append(job.scene_id)
            if job.scene_id in self.process_dies:
                yield Outcome(job, None, "Traceback ...\nprocess killed by SIGSEGV", 2, "died")
            elif job.scene_id in self.expert_fails:
                failure = DemoFailure(
                    scene_id=job.scene_id, scene_sha256=sha256_file(job.scene_file),
                    cause="expert", phase="grasp:missed", reason="upright",
                )  # fmt: skip
                failure.save(failure_path(job.run, job.scene_id))
                yield Outcome(job, DemoResult.of_failure(failure), "", 1)
            else:
                folder, _, _ = self.write(self.run, job.scene_id)
                yield Outcome(job, DemoResult.of_episode(load_manifest(folder)), "", 1)

    def collect(self, workers=1, **options):
        self.given.clear()
        results = collect.collect_demos(self.run, CollectOptions(**options), workers=workers)
        return {r.scene_id: r for r in results}


@pytest.fixture
def stand(tmp_path, small_scene, write_synthetic_episode, monkeypatch):
    for scene_id in IDS:
        scene = small_scene.model_copy(update={"scene_id": scene_id})
        scene.save(tmp_path / "scenes" / f"{scene_id}.yaml")
    stand = Stand(tmp_path, write_synthetic_episode)
    monkeypatch.setattr(collect, "run_tasks", stand.run_tasks)
    return stand


def test_every_scene_gets_an_episode_and_the_run_a_summary(stand):
    results = stand.collect(workers=2)
    assert set(results) == set(IDS)
    assert all(r.success and not r.earlier for r in results.values())
    summary = json.loads((stand.run / "demo_summary.json").read_text())
    assert (summary["scenes"], summary["episodes"], summary["success_rate"]) == (3, 3, 1.0)
    assert summary["workers"] == 2
    assert summary["bytes_per_episode"] > 1000


def test_whole_episodes_are_not_made_again(stand):
    stand.collect()
    results = stand.collect()
    assert stand.given == []
    assert all(r.success and r.earlier for r in results.values())
    shutil.rmtree(stand.run / "episodes" / IDS[1])
    stand.collect()
    assert stand.given == [IDS[1]]


def test_overwrite_makes_all_again(stand):
    stand.collect()
    stand.collect(overwrite=True)
    assert stand.given == list(IDS)


def test_a_failure_is_recorded_and_not_tried_again(stand):
    stand.expert_fails = {IDS[1]}
    first = stand.collect()[IDS[1]]
    assert (first.success, first.phase, first.reason) == (False, "grasp:missed", "upright")
    again = stand.collect()[IDS[1]]
    assert (again.success, again.earlier, again.phase) == (False, True, "grasp:missed")
    assert stand.given == []
    summary = json.loads((stand.run / "demo_summary.json").read_text())
    assert summary["failures_by_phase"] == {"grasp:missed": 1}
    assert summary["failed_scenes"] == {IDS[1]: "upright"}
    assert summary["success_rate"] == pytest.approx(2 / 3)


def test_a_failure_is_tried_again_when_its_scene_changed_or_by_overwrite(stand, small_scene):
    stand.expert_fails = {IDS[1]}
    stand.collect()
    stand.collect(overwrite=True)
    assert IDS[1] in stand.given
    changed = small_scene.model_copy(update={"scene_id": IDS[1], "split": "val"})
    changed.save(stand.run / "scenes" / f"{IDS[1]}.yaml")
    stand.collect()
    assert stand.given == [IDS[1]]


def test_a_scene_whose_process_died_is_recorded_and_tried_again_next_time(stand):
    stand.process_dies = {IDS[2]}
    result = stand.collect()[IDS[2]]
    assert (result.success, result.reason) == (False, "process killed by SIGSEGV")
    assert (result.phase, result.tries) == ("process:died", 2)
    assert failure_path(stand.run, IDS[2]).is_file()
    stand.process_dies = set()
    assert stand.collect()[IDS[2]].success
    assert stand.given == [IDS[2]]
    assert not failure_path(stand.run, IDS[2]).exists()


def test_what_killed_processes_left_is_removed(stand):
    stand.collect()
    left = stand.run / "episodes" / ".partial-999999999-000007"
    left.mkdir()
    stand.collect()
    assert not left.exists()


def test_a_damaged_episode_is_made_again(stand):
    stand.collect()
    log = stand.run / "episodes" / IDS[0] / "episode.mcap"
    log.write_bytes(log.read_bytes()[:1000])
    stand.collect()
    assert stand.given == [IDS[0]]
    assert check_episode(log.parent) == []


def test_an_episode_of_another_scene_is_refused(stand, small_scene):
    stand.collect()
    changed = small_scene.model_copy(update={"scene_id": IDS[1], "split": "val"})
    changed.save(stand.run / "scenes" / f"{IDS[1]}.yaml")
    with pytest.raises(EpisodeError, match=r"recorded from another scene .* --overwrite"):
        stand.collect()


def test_a_run_without_scenes_says_so(tmp_path):
    with pytest.raises(ConfigError, match="expected scene files, found none; run sample first"):
        next(collect.collect_demos(tmp_path))


def test_a_summary_of_nothing_divides_by_nothing():
    summary = summarize([], workers=1, wall_s=0.0)
    assert (summary.success_rate, summary.camera_sets_per_s, summary.episodes_per_hour) == (0, 0, 0)


def test_a_finished_run_says_that_nothing_was_left_to_do():
    done = DemoResult("000000", success=True, earlier=True, steps=185)
    new = dataclasses.replace(done, earlier=False, physics_s=2.0)
    lines = {
        case: "\n".join(report_lines(summarize(results, workers=1, wall_s=4.0)))
        for case, results in (("finished", [done]), ("one new", [done, new]))
    }
    assert "nothing was left to do" in lines["finished"]
    assert "steps/s" not in lines["finished"]
    assert "nothing" not in lines["one new"]
    assert "92 control steps/s" in lines["one new"]
