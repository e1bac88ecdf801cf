from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from codediffuser.errors import (
    ConfigError,
    LanguageModelError,
    NotRegisteredError,
    ProgramError,
    SetupError,
)
from codediffuser.labeling.language.checker import check_program
from codediffuser.labeling.language.grounding import ground
from codediffuser.labeling.language.models import Prompt, extract_program, get_model
from codediffuser.labeling.language.openai_model import OpenAIModel
from codediffuser.labeling.language.prompts import messages
from codediffuser.labeling.language.recording import RecordingModel, ReplayModel

CATEGORIES = ("battery", "slot", "crate")
GOOD = """output_var = [self.detect("battery")[0], self.detect("slot")[0]["pointer"]]"""


class Server:
    """A chat server that answers from a list and keeps what it was sent."""

    def __init__(self) -> None:
        self.answers: list[Any] = []
        self.requests: list[dict[str, Any]] = []
        self.keys: list[str | None] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                outer.requests.append({"path": self.path, **json.loads(body)})
                outer.keys.append(self.headers.get("Authorization"))
                outer.respond(self)

            def log_message(self, *args: Any) -> None:
                pass

        self._http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._http.server_port}/v1"
        threading.Thread(target=self._http.serve_forever, daemon=True).start()

    def respond(self, handler: BaseHTTPRequestHandler) -> None:
        answer = self.answers.pop(0) if self.answers else 500
        status = answer if isinstance(answer, int) else 200
        if callable(answer):
            answer = answer()
        if isinstance(answer, str):
            answer = {
                "id": "1", "object": "chat.completion", "created": 0, "model": "m",
                "choices": [{
                    "index": 0, "finish_reason": "stop",
                    "message": {"role": "assistant", "content": answer},
                }],
            }  # fmt: skip
        data = answer if isinstance(answer, bytes) else json.dumps(answer).encode()
        try:
            handler.send_response(status)
            handler.send_header("Content-Type", "application/json")
            handler.send_header("Content-Length", str(len(data)))
            handler.end_headers()
            handler.wfile.write(data)
        except OSError:
            pass  # The client has given up, as one test wants it to.

    def close(self) -> None:
        self._http.shutdown()
        self._http.server_close()


@pytest.fixture
def server() -> Iterator[Server]:
    serving = Server()
    yield serving
    serving.close()


@pytest.fixture
def model(server: Server) -> OpenAIModel:
    return OpenAIModel(
        base_url=server.url, model="test-model", api_key="k", timeout_s=5.0, retries=0
    )


def test_a_reply_becomes_targets(server: Server, model: OpenAIModel, make_scene) -> None:
    server.answers = [f"Here it is:\n```python\n{GOOD}\n```\nDone."]
    grounding = ground("do the thing", make_scene(), model)
    assert grounding.targets == (("pick", "b"), ("place", "slot_0"))
    request = server.requests[0]
    assert (request["temperature"], request["seed"], request["model"]) == (0, 0, "test-model")
    assert request["path"] == "/v1/chat/completions" and server.keys == ["Bearer k"]
    # Plain categories are not worth a question to the model.
    assert len(server.requests) == 1


def test_a_phrase_to_see_is_asked_as_a_detection(
    server: Server, model: OpenAIModel, make_scene
) -> None:
    server.answers = [
        'output_var = [self.detect("green battery")[0], self.detect("slot")[1]]',
        "```\ni = self.find_instance_in_category('green', 'battery')\n"
        "output_var = [self.get_obj('battery')[k] for k in i]\n```",
    ]
    assert ground("do it", make_scene(), model).target("place") == "slot_1"
    assert "Phrase: green battery" in server.requests[1]["messages"][-1]["content"]
    assert "self.detect" not in server.requests[1]["messages"][0]["content"]


@pytest.mark.parametrize(
    ("bad", "told"),
    [
        ("```python\nimport os\noutput_var = []\n```", "line 1, column 1: imports"),
        ("I cannot help with that.", "holds no program"),
        ("```python\noutput_var = [1,\n```", "no Python"),
        ("```python\noutput_var = [[][3], None]\n```", "IndexError"),
        ("```python\noutput_var = []\n```", "expected [pick, place]"),
        (
            "```python\ns = self.detect('slot')\noutput_var = [s[0], s[1]]\n```",
            "expected a battery",
        ),
    ],
)
def test_one_repair_round_tells_what_was_wrong(
    bad: str, told: str, server: Server, model: OpenAIModel, make_scene
) -> None:
    server.answers = [bad, f"```\n{GOOD}\n```"]
    grounding = ground("do the thing", make_scene(), model)
    assert grounding.target("pick") == "b"
    talk = server.requests[1]["messages"]
    assert talk[-2] == {"role": "assistant", "content": bad}
    assert told in talk[-1]["content"]
    composed = [a for a in grounding.attempts if a.kind == "compose"]
    assert [a.error is None for a in composed] == [False, True]


def test_after_one_repair_it_is_an_error(server: Server, model: OpenAIModel, make_scene) -> None:
    server.answers = ["```\nimport os\n```"] * 3
    with pytest.raises(ProgramError, match=r"compose 'do the thing'.*imports are not allowed"):
        ground("do the thing", make_scene(), model)
    assert len(server.requests) == 2


def test_a_server_error_says_so(server: Server, model: OpenAIModel, make_scene) -> None:
    server.answers = [500]
    with pytest.raises(LanguageModelError, match=r"'test-model' at http://127.*HTTP 500"):
        ground("do the thing", make_scene(), model)


def test_a_server_error_is_tried_again(server: Server, make_scene) -> None:
    patient = OpenAIModel(base_url=server.url, model="m", api_key="k", retries=1)
    server.answers = [500, f"```\n{GOOD}\n```"]
    assert ground("do the thing", make_scene(), patient).target("pick") == "b"


def test_a_slow_server_is_given_up(server: Server, make_scene) -> None:
    hasty = OpenAIModel(base_url=server.url, model="m", api_key="k", timeout_s=0.2, retries=0)
    server.answers = [lambda: time.sleep(0.6) or "late"]
    began = time.perf_counter()
    with pytest.raises(LanguageModelError, match=r"no answer within 0.2 s"):
        ground("do the thing", make_scene(), hasty)
    assert time.perf_counter() - began < 2.0


@pytest.mark.parametrize(
    "answer", [b"not json", {"choices": []}, {"error": "x"}, [], {"choices": [{"index": 0}]}, ""]
)
def test_an_answer_without_text_is_named(
    answer: Any, server: Server, model: OpenAIModel, make_scene
) -> None:
    server.answers = [answer]
    with pytest.raises(LanguageModelError, match="'test-model'"):
        ground("do the thing", make_scene(), model)


def test_no_server_is_named(make_scene) -> None:
    away = OpenAIModel(base_url="http://127.0.0.1:9/v1", model="m", api_key="k", retries=0)
    with pytest.raises(LanguageModelError, match="cannot be reached"):
        ground("do the thing", make_scene(), away)


def test_settings_come_from_the_environment(
    server: Server, monkeypatch: pytest.MonkeyPatch, make_scene
) -> None:
    for name, value in (
        ("OPENAI_BASE_URL", server.url),
        ("OPENAI_API_KEY", "secret"),
        ("CODEDIFFUSER_LANGUAGE_MODEL", "from-env"),
    ):
        monkeypatch.setenv(name, value)
    server.answers = [f"```\n{GOOD}\n```"]
    ground("do the thing", make_scene(), "openai")
    assert server.requests[0]["model"] == "from-env" and server.keys == ["Bearer secret"]


def test_a_missing_key_is_told_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    with pytest.raises(SetupError, match="set OPENAI_API_KEY"):
        get_model("openai")


def test_recorded_replies_answer_without_a_server(
    server: Server, model: OpenAIModel, make_scene, tmp_path
) -> None:
    path = tmp_path / "replies" / "log.jsonl"
    server.answers = ["```\nimport os\n```", f"```\n{GOOD}\n```"]
    first = ground("do the thing", make_scene(), RecordingModel(model, path))
    again = ground("do the thing", make_scene(), get_model("replay", path=path))
    assert (again.targets, again.program) == (first.targets, first.program)
    assert len(server.requests) == 2
    with pytest.raises(LanguageModelError, match="no reply recorded to compose 'something else'"):
        ground("something else", make_scene(), ReplayModel(path))


def test_a_cut_off_record_keeps_its_whole_lines(
    server: Server, model: OpenAIModel, make_scene, tmp_path
) -> None:
    path = tmp_path / "log.jsonl"
    server.answers = [f"```\n{GOOD}\n```"]
    ground("do the thing", make_scene(), RecordingModel(model, path))
    path.write_text(path.read_text() + '{"schema": "codedif')
    assert ground("do the thing", make_scene(), ReplayModel(path)).target("pick") == "b"
    path.write_text("broken\n" + path.read_text())
    with pytest.raises(ConfigError, match=r"log\.jsonl:1: expected one recorded reply a line"):
        ReplayModel(path)
    with pytest.raises(ConfigError, match="cannot read recorded replies"):
        ReplayModel(tmp_path / "none.jsonl")


def test_unknown_models_are_named_with_the_closest() -> None:
    with pytest.raises(NotRegisteredError, match="Did you mean 'builtin'"):
        get_model("buildin")


EXTRACTED = {
    "```python\nx\n```": "x\n",
    "```\nx\n```": "x\n",
    "``` py\nx\n```": "x\n",
    "```Python title\nx\n```": "x\n",
    "text\n```python\nx\n```\nmore": "x\n",
    "```python\nx\n": "x\n",
    "```python\r\nx\r\n```": "x\n",
    "    ```python\n    x\n      y\n    ```": "x\n  y\n",
    "output_var = 1": "output_var = 1\n",
    "\n\n  output_var = 1\n  x\n": "output_var = 1\nx\n",
    "```\noutput_var = 1\n```\n```\nx = 2\n```": "output_var = 1\n",
    "```\noutput_var = 1\n```\n```\noutput_var = 2\n```": "output_var = 2\n",
    "```json\n{}\n```\n```python\nx\n```": "x\n",
}


@pytest.mark.parametrize("reply", EXTRACTED, ids=repr)
def test_programs_are_found_in_replies(reply: str) -> None:
    assert extract_program(reply) == EXTRACTED[reply]


@pytest.mark.parametrize("reply", ["", "   \n", "Sorry.", "```json\n{}\n```"])
def test_replies_without_program_are_refused(reply: str) -> None:
    with pytest.raises(ProgramError, match="holds no program"):
        extract_program(reply)


@pytest.mark.parametrize("kind", ["compose", "detect"])
def test_solved_examples_keep_the_rules_they_teach(kind: Any) -> None:
    talk = messages(Prompt(kind, "x", CATEGORIES))
    solved = [m["content"] for m in talk if m["role"] == "assistant"]
    assert len(solved) >= 2
    for reply in solved:
        check_program(extract_program(reply), kind)
    assert "right is +x" in talk[0]["content"] and "back is +y" in talk[0]["content"]
