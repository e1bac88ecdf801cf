"""Programs from any server that speaks the OpenAI chat protocol, in the cloud or on the desk."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from codediffuser.errors import LanguageModelError, SetupError
from codediffuser.labeling.language.detection import compose_detection
from codediffuser.labeling.language.models import LANGUAGE_MODELS, LanguageModel, Prompt
from codediffuser.labeling.language.prompts import messages

if TYPE_CHECKING:
    from openai import OpenAI

DEFAULT_MODEL = "gpt-4o"
URL_VARIABLE = "OPENAI_BASE_URL"
KEY_VARIABLE = "OPENAI_API_KEY"
MODEL_VARIABLE = "CODEDIFFUSER_LANGUAGE_MODEL"


@LANGUAGE_MODELS.add("openai")
class OpenAIModel(LanguageModel):
    """Asks a chat model, at temperature 0 and with a fixed seed.

    Args:
        base_url: Where the server is; None reads `OPENAI_BASE_URL`, else OpenAI's own.
        model: Its name; None reads `CODEDIFFUSER_LANGUAGE_MODEL`, else `DEFAULT_MODEL`.
        api_key: None reads `OPENAI_API_KEY`. A server of one's own takes any.
        timeout_s: Seconds that one request may take.
        retries: How often a request is sent again after a failure of the network or the server.
        max_tokens: Length of a reply.

    Raises:
        SetupError: There is no key.
    """

    def __init__(
        self,
        *,
        base_url: str | None = None,
        model: str | None = None,
        api_key: str | None = None,
        timeout_s: float = 60.0,
        retries: int = 1,
        max_tokens: int = 2_000,
    ) -> None:
        self.base_url = base_url or os.environ.get(URL_VARIABLE) or None
        self.model = model or os.environ.get(MODEL_VARIABLE) or DEFAULT_MODEL
        self.name = f"openai:{self.model}"
        self._key = api_key or os.environ.get(KEY_VARIABLE) or ""
        self._timeout_s = timeout_s
        self._retries = retries
        self._max_tokens = max_tokens
        self._client: OpenAI | None = None
        if not self._key:
            raise SetupError(
                f"the language model '{self.model}' needs a key: set {KEY_VARIABLE} (any text for "
                f"a server of your own, with {URL_VARIABLE}), or use the built-in composer"
            )

    def reply(self, prompt: Prompt) -> str:
        """What the server's model answers.

        Raises:
            LanguageModelError: The server cannot be reached, refuses, takes too long, or its answer
                has no text.
        """
        if prompt.kind == "detect" and prompt.text in prompt.categories:
            return compose_detection(prompt.text, (prompt.text,))  # Nothing to ask about.
        return self._content(self._ask(messages(prompt)))

    def _ask(self, talk: list[dict[str, str]]) -> Any:
        import openai

        if self._client is None:
            self._client = openai.OpenAI(
                base_url=self.base_url,
                api_key=self._key,
                timeout=self._timeout_s,
                max_retries=self._retries,
            )
        try:
            return self._client.chat.completions.create(
                model=self.model,
                messages=talk,  # type: ignore[arg-type]
                temperature=0,
                seed=0,
                max_tokens=self._max_tokens,
            )
        except openai.APITimeoutError:
            raise LanguageModelError(
                f"{self._where()}: no answer within {self._timeout_s:g} s; try again or raise "
                "timeout_s"
            ) from None
        except openai.APIConnectionError as error:
            raise LanguageModelError(
                f"{self._where()}: cannot be reached ({error}); check the address and the network"
            ) from None
        except openai.APIStatusError as error:
            raise LanguageModelError(
                f"{self._where()}: the server answered HTTP {error.status_code}; check the key, "
                "the model's name and the server's log"
            ) from None
        except (openai.OpenAIError, ValueError) as error:
            raise LanguageModelError(f"{self._where()}: unreadable answer: {error}") from None

    def _content(self, answer: Any) -> str:
        """Text of the first choice, whatever else the server sent."""
        choices = getattr(answer, "choices", None) or []
        message = getattr(choices[0], "message", None) if choices else None
        content = getattr(message, "content", None)
        if not isinstance(content, str) or not content.strip():
            raise LanguageModelError(
                f"{self._where()}: the answer has no text; is it a chat completions server?"
            )
        return content

    def _where(self) -> str:
        return f"language model '{self.model}' at {self.base_url or 'the default address'}"
