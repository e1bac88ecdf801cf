"""What users get wrong: one clear line, exit code 2, and nothing on disk is lost."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from codediffuser import cli
from codediffuser.files import write_json

Run = Callable[..., tuple[int, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command in this process; returns exit code and what it said, on one line."""

    def call(*words: str | Path) -> tuple[int, str]:
        code = cli.run([str(word) for word in words])
        return code, " ".join(capsys.readouterr().err.split())

    return call


def test_unknown_task_gets_the_closest_name(run: Run, tmp_path: Path) -> None:
    code, said = run("sample", "pack_batery", "--out", tmp_path / "scenes")
    assert code == 2
    assert "Did you mean 'pack_battery'?" in said
    assert not (tmp_path / "scenes").exists()


def test_sample_refuses_a_count_of_zero(run: Run, tmp_path: Path) -> None:
    code, said = run("sample", "pack_battery", "-n", "0", "--out", tmp_path)
    assert (code, "at least 1" in said) == (2, True)


def test_unplaceable_scene_names_the_key_to_change(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from codediffuser.datagen.tasks.pack_battery import PackBattery

    text = (
        PackBattery.config_path().read_text().replace("min_distance_m: 0.09", "min_distance_m: 9")
    )
    crowded = tmp_path / "crowded.yaml"
    crowded.write_text(text)
    monkeypatch.setattr(PackBattery, "config_path", classmethod(lambda cls: crowded))
    code, said = run("sample", "pack_battery", "-n", "20", "--out", tmp_path / "scenes")
    assert code == 2
    assert "min_distance_m" in said


def test_unknown_key_in_a_task_yaml_gets_the_closest_key(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from codediffuser.datagen.tasks.pack_battery import PackBattery

    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(PackBattery.config_path().read_text().replace("max_steps:", "max_step:"))
    monkeypatch.setattr(PackBattery, "config_path", classmethod(lambda cls: wrong))
    code, said = run("sample", "pack_battery", "--out", tmp_path / "scenes")
    assert code == 2
    assert "unknown key 'max_step'; did you mean 'max_steps'?" in said


def test_demo_without_scenes_names_the_verb_before_it(run: Run, tmp_path: Path) -> None:
    code, said = run("demo", tmp_path)
    assert (code, "run sample first" in said) == (2, True)


def test_label_without_episodes_names_the_verb_before_it(run: Run, tmp_path: Path) -> None:
    code, said = run("label", tmp_path)
    assert (code, "no episodes to label; run `codediffuser demo" in said) == (2, True)


def test_label_for_other_machines_asks_for_a_token(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CODEDIFFUSER_LABEL_TOKEN", raising=False)
    code, said = run("label", tmp_path, "--host", "0.0.0.0")
    assert (code, "CODEDIFFUSER_LABEL_TOKEN" in said) == (2, True)


def test_label_does_one_thing_at_a_time(run: Run, tmp_path: Path) -> None:
    code, said = run("label", tmp_path, "--auto", "--report")
    assert (code, "choose one of --auto, --report" in said) == (2, True)


def test_convert_lists_episodes_without_labels(
    run: Run, tmp_path: Path, write_synthetic_episode: Callable[..., object]
) -> None:
    write_synthetic_episode(tmp_path, "000007")
    code, said = run("convert", tmp_path)
    assert code == 2
    assert "000007" in said
    assert f"codediffuser label {tmp_path} --auto" in said
    assert (tmp_path / "episodes" / "000007").is_dir()
    assert not (tmp_path / "lerobot").exists()


def test_truncated_log_is_an_error_with_sizes_and_the_episode_stays(
    run: Run, tmp_path: Path, write_synthetic_episode: Callable[..., object]
) -> None:
    write_synthetic_episode(tmp_path, "000007")
    log = tmp_path / "episodes" / "000007" / "episode.mcap"
    whole = log.read_bytes()
    log.write_bytes(whole[: len(whole) // 2])
    code, said = run("label", tmp_path, "--auto")
    assert code == 2
    assert "episode.mcap" in said
    assert str(len(whole)) in said
    assert log.is_file()


def test_validate_reports_a_truncated_log_with_exit_code_3(
    run: Run, tmp_path: Path, write_synthetic_episode: Callable[..., object]
) -> None:
    write_synthetic_episode(tmp_path, "000007")
    log = tmp_path / "episodes" / "000007" / "episode.mcap"
    log.write_bytes(log.read_bytes()[:-100])
    code, said = run("validate", tmp_path)
    assert code == 3
    assert "episode.mcap" in said


def test_dataset_of_another_schema_is_refused_by_name(run: Run, tmp_path: Path) -> None:
    write_json(
        tmp_path / "lerobot" / "meta" / "info.json", {"codebase_version": "v2.1", "features": {}}
    )
    code, said = run("train", tmp_path)
    assert code == 2
    assert "v2.1" in said
    assert "v3.0" in said


def test_train_without_a_dataset_names_the_verb_before_it(run: Run, tmp_path: Path) -> None:
    code, said = run("train", tmp_path)
    assert (code, "codediffuser convert" in said) == (2, True)


def test_unknown_preset_lists_the_presets(run: Run, tmp_path: Path) -> None:
    code, said = run("train", tmp_path, "--preset", "cpuu")
    assert code == 2
    assert "Did you mean 'cpu'?" in said


def test_debug_lets_the_error_through(tmp_path: Path) -> None:
    from codediffuser.errors import ConfigError

    with pytest.raises(ConfigError):
        cli.run(["demo", str(tmp_path), "--debug"])


def test_unknown_verb_exits_with_2() -> None:
    with pytest.raises(SystemExit) as ended:
        cli.run(["smple"])
    assert ended.value.code == 2


@pytest.mark.parametrize("verb", sorted(cli.VERBS))
def test_every_verb_explains_itself(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.run([verb, "--help"])
    assert ended.value.code == 0
    assert cli.summary(cli.VERBS[verb]).split()[0] in capsys.readouterr().out


TEMPLATES = (
    "schema: codediffuser.instruction_templates/1\ntasks:\n  pack_battery:\n"
    "    components: {{battery: [{battery}], slot: [nearest slot]}}\n"
    "    templates: {{no_slackness: ['{sentence}']}}\n"
)


@pytest.mark.parametrize(
    ("battery", "sentence", "message"),
    [
        ("left-mots battery", "The {battery} to the {slot}.",
         "key 'tasks.pack_battery.components.battery': Unknown phrase 'left-mots battery'. "
         "Did you mean 'left-most battery'?"),
        ("left-most battery", "The {batery} to the {slot}.",
         "key 'tasks.pack_battery.templates.no_slackness.0': Unknown placeholder 'batery'. "
         "Did you mean 'battery'?"),
        ("left-most battery", "The {battery}.", "names {battery} and {slot}, got {battery}"),
    ],
)  # fmt: skip
def test_wrong_sentences_name_file_key_and_placeholder(
    run: Run, tmp_path: Path, battery: str, sentence: str, message: str
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(TEMPLATES.format(battery=battery, sentence=sentence))
    out = tmp_path / "scenes"
    code, said = run("sample", "pack_battery", "--templates", path, "--out", out)
    assert code == 2
    assert "mine.yaml" in said
    assert message in said
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--variant", "reel"), "Unknown variant 'reel'. Did you mean 'real'? Known: sim, real."),
        (("--picks", "9"), "picks: waiting batteries: expected 1 to 4, got 9"),
        (("--places", "0"), "places: free slots: expected 1 to 12, got 0"),
        (("--places", "13"), "places: free slots: expected 1 to 12, got 13"),
        (("--stratify", "kinds"), "Unknown factor 'kinds'. Did you mean 'kind'?"),
        (("--templates", "nowhere.yaml"), "nowhere.yaml: no such instruction_templates file"),
    ],
)
def test_sampling_options_out_of_range_are_refused(
    run: Run, tmp_path: Path, words: tuple[str, ...], message: str
) -> None:
    code, said = run("sample", "pack_battery", "--out", tmp_path / "scenes", *words)
    assert code == 2
    assert message in said
    assert not list((tmp_path / "scenes").glob("*.yaml"))
