"""Keep what a language model replied, and answer from the record later: offline, and the same.

One JSON object a line; a line holds the prompt, its hash, the reply and who gave it.
"""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Any

from codediffuser.errors import ConfigError, LanguageModelError
from codediffuser.labeling.label import Role
from codediffuser.labeling.language.models import LANGUAGE_MODELS, LanguageModel, Prompt

SCHEMA = "codediffuser.language_reply/1"


class RecordingModel(LanguageModel):
    """Passes prompts on and appends every reply to a file.

    Args:
        inner: The model that replies.
        path: JSONL file; made if missing, else continued.
    """

    def __init__(self, inner: LanguageModel, path: Path) -> None:
        self.name, self.repairs = inner.name, inner.repairs
        self._inner = inner
        self._path = path
        self._lock = threading.Lock()

    def reply(self, prompt: Prompt) -> str:
        """The inner model's reply."""
        began = time.perf_counter()
        text = self._inner.reply(prompt)
        line: dict[str, Any] = {
            "schema": SCHEMA,
            "key": prompt.key(),
            "model": self._inner.name,
            "seconds": round(time.perf_counter() - began, 4),
            "prompt": prompt.as_json(),
            "reply": text,
        }
        # Appending one short line is atomic enough: a cut-off last line is skipped when read.
        with self._lock:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(line, ensure_ascii=False) + "\n")
        return text

    def looked_for(self, prompt: Prompt, role: Role) -> str:
        """As the inner model."""
        return self._inner.looked_for(prompt, role)


@LANGUAGE_MODELS.add("replay")
class ReplayModel(LanguageModel):
    """Answers from a record; the last reply to a prompt counts.

    Args:
        path: File that a `RecordingModel` wrote.

    Raises:
        ConfigError: The file is missing, or a line other than the last is no reply.
    """

    name = "replay"

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._replies = _read_replies(self._path)

    def reply(self, prompt: Prompt) -> str:
        """The recorded reply.

        Raises:
            LanguageModelError: The record has no reply to this prompt.
        """
        try:
            return self._replies[prompt.key()]
        except KeyError:
            raise LanguageModelError(
                f"{self._path}: no reply recorded to {prompt.kind} {prompt.text!r} with "
                f"{len(prompt.rejected)} earlier replies; record it with the model first"
            ) from None


def _read_replies(path: Path) -> dict[str, str]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot read recorded replies: {error.strerror or error}"
        ) from None
    replies = {}
    for number, line in enumerate(lines, start=1):
        try:
            entry = json.loads(line)
            if entry["schema"] != SCHEMA:
                raise ConfigError(
                    f"{path}:{number}: expected schema '{SCHEMA}', got '{entry['schema']}'"
                )
            replies[entry["key"]] = str(entry["reply"])
        except (json.JSONDecodeError, KeyError, TypeError):
            if number == len(lines):
                break  # The writer was killed in the middle of its last line.
            raise ConfigError(f"{path}:{number}: expected one recorded reply a line") from None
    return replies
