"""Facts about the report: self-contained, complete, safe, and true to the results."""

import json
import re
from html.parser import HTMLParser

import pytest

from codediffuser.eval import plots
from codediffuser.eval.report import render_report, write_report
from codediffuser.eval.results import AttentionRecord, EvalResults
from codediffuser.eval.summary import compare_results, summarize

VOID = {"meta", "img", "br", "input", "link", "hr"}


class Balance(HTMLParser):
    """Counts tags that are left open or closed without being open."""

    def __init__(self):
        super().__init__()
        self.open, self.faults, self.addresses = [], [], []

    def handle_starttag(self, tag, attrs):
        self.addresses += [v for k, v in attrs if k in ("src", "href", "poster") and v]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.faults.append(tag)


def parse(text):
    parser = Balance()
    parser.feed(text)
    return parser


@pytest.fixture
def folder_with_pictures(tmp_path, make_rollout):
    home = tmp_path / "rollouts" / "000000"
    home.mkdir(parents=True)
    (home / "video.mp4").write_bytes(b"a film")
    (home / "keyframes.jpg").write_bytes(b"a strip")
    return tmp_path


def test_report_loads_nothing_from_elsewhere(folder_with_pictures, make_rollout, make_results):
    results = make_results([make_rollout(video="video.mp4", keyframes="keyframes.jpg")])
    text = render_report(results, folder_with_pictures)
    for address in parse(text).addresses:
        assert address.startswith(("#", "data:", "rollouts/")), address
    assert not re.search(r"https?://|@import|url\(", text)
    assert "YSBmaWxt" in text  # "a film" in base64
    assert "data:image/jpeg;base64,YSBzdHJpcA==" in text


def test_report_is_well_formed(tmp_path, make_rollout, make_results):
    rollouts = [make_rollout(0), make_rollout(1, failure="place:on_rim", kind="no_slackness")]
    parsed = parse(render_report(make_results(rollouts), tmp_path))
    assert parsed.faults == []
    assert parsed.open == []


def test_report_escapes_words_and_programs(tmp_path, make_rollout, make_results):
    attack = "<script>alert(1)</script>"
    rollout = make_rollout(
        instruction=attack, detail=attack, failure=attack,
        attention=AttentionRecord(pair=None, right=False, program=attack),
    )  # fmt: skip
    assert attack not in render_report(make_results([rollout]), tmp_path)


def test_report_says_what_the_results_say(tmp_path, make_rollout, make_results):
    wrong = AttentionRecord(pair=("battery_1", "slot_2"), right=False)
    rollouts = [
        *(make_rollout(i) for i in range(8)),
        make_rollout(8, failure="place:on_rim", ever_success=True, first_success_step=99),
        make_rollout(9, failure="grasp:wrong_object", attention=wrong),
    ]
    text = render_report(make_results(rollouts), tmp_path)
    assert "80 %" in text and "[49 – 94 %]" in text
    assert "90 %" in text  # max over time
    assert "place:on_rim" in text and "grasp:wrong_object" in text
    assert "attention wrong" in text
    assert "held at 4.0 s" in text
    assert "c0ffee" in text and "root seed 7" in text and "EVAL_SCENE" in text


def test_report_of_a_rollout_that_never_began_says_why(tmp_path, make_rollout, make_results):
    rollout = make_rollout(
        failure="language:fits_nothing", detail="there is no red battery", final=None, steps=0,
        attention=AttentionRecord(), followed=False,
    )  # fmt: skip
    text = render_report(make_results([rollout]), tmp_path)
    assert "there is no red battery" in text
    assert "nothing attended" in text
    assert "the rollout did not begin" in text


def test_oracle_report_does_not_speak_of_programs(tmp_path, make_results):
    text = render_report(make_results(attention="oracle"), tmp_path)
    assert "true target" in text
    assert "Attention by kind" not in text


@pytest.mark.parametrize(
    "stress, share, words",
    [("zeroed", 0.0, "set to zero"), ("swapped", 0.15, "15% of the attended")],
)  # fmt: skip
def test_report_names_the_stress(tmp_path, make_results, stress, share, words):
    assert words in render_report(make_results(stress=stress, swap_share=share), tmp_path)


def test_videos_of_failures_are_embedded_first(tmp_path, make_rollout, make_results, monkeypatch):
    monkeypatch.setattr("codediffuser.eval.report.MAX_VIDEO_BYTES", 5)
    for name in ("000000", "000001"):
        (tmp_path / "rollouts" / name).mkdir(parents=True)
        (tmp_path / "rollouts" / name / "video.mp4").write_bytes(f"film{name[-1]}".encode())
    rollouts = [
        make_rollout(0, video="video.mp4"),
        make_rollout(1, video="video.mp4", failure="place:on_rim"),
    ]
    text = render_report(make_results(rollouts), tmp_path)
    assert "ZmlsbTE=" in text and "ZmlsbTA=" not in text
    assert 'href="rollouts/000000/video.mp4"' in text


def test_write_report_and_results_read_back(tmp_path, make_results):
    results = make_results()
    results.save(tmp_path / "results.json")
    assert write_report(results, tmp_path) == tmp_path / "report.html"
    assert EvalResults.load(tmp_path / "results.json") == results
    assert json.loads((tmp_path / "results.json").read_text())["schema"] == "codediffuser.eval/1"


def test_results_with_not_a_number_are_still_json(tmp_path, make_rollout, make_results):
    rollout = make_rollout(failure="policy:not_finite")
    broken = rollout.final.conditions[0].model_validate(
        rollout.final.conditions[0].model_dump() | {"value": float("nan")}
    )
    final = rollout.final.model_copy(update={"conditions": (broken,)})
    results = make_results([rollout.model_copy(update={"final": final})])
    results.save(tmp_path / "results.json")
    json.loads((tmp_path / "results.json").read_text(), parse_constant=pytest.fail)
    assert "–" in render_report(results, tmp_path)


def test_summary_of_nothing_has_no_trials():
    summary = summarize([])
    assert summary.success.trials == 0 and summary.success.share is None
    assert summary.by_ambiguity == ()


def test_comparison_meets_only_equal_scenes(make_rollout, make_results):
    ours = make_results([make_rollout(0), make_rollout(1), make_rollout(2)])
    same = make_results([make_rollout(i, failure="place:on_rim") for i in (1, 2, 3)])
    foreign = make_results([make_rollout(0, scene_sha256="other")])
    compared = compare_results(ours, [("zeroed", same), ("foreign", foreign)]).comparisons
    assert [c.name for c in compared] == ["zeroed"]
    assert (compared[0].only_a, compared[0].only_b, compared[0].success_a.trials) == (2, 0, 2)


@pytest.mark.parametrize("values", [[], [0.001], [0.001, 0.5, 0.03]])
def test_histogram_counts_every_value_once(values):
    svg = plots.histogram(
        values, [v < 0.03 for v in values], 0.03, unit="mm", scale=1000, limit=0.06
    )
    counted = sum(int(n) for n in re.findall(r"mm: (\d+)</title>", svg))
    assert counted == len(values)


def test_plot_labels_are_escaped():
    assert "<b>" not in plots.bar_plot({"<b>": 1})
