"""Versioned, strict YAML and JSON: every file says `schema: codediffuser.<kind>/<n>` first.

Old versions are lifted by pure functions, newer ones are refused by name, and only the newest is
written. Unknown keys are errors with a closest-name hint.
"""

from __future__ import annotations

import difflib
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from codediffuser.errors import ConfigError, SchemaVersionError
from codediffuser.files import write_text

Raw = dict[str, Any]
M = TypeVar("M", bound=BaseModel)


class Strict(BaseModel):
    """Base of everything that is parsed: no unknown keys, no change after parsing."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class Document(Strict):
    """Base of a file's top level. Subclasses set `KIND` and `VERSION`.

    `UPGRADES[n]` takes the raw mapping of version n to version n + 1.
    """

    KIND: ClassVar[str]
    VERSION: ClassVar[int] = 1
    UPGRADES: ClassVar[dict[int, Callable[[Raw], Raw]]] = {}

    schema_: str = Field(default="", alias="schema")

    @model_validator(mode="after")
    def _fill_schema(self) -> Self:
        object.__setattr__(self, "schema_", self.schema_name())
        return self

    @classmethod
    def schema_name(cls) -> str:
        """What the first line of a file of this kind says."""
        return f"codediffuser.{cls.KIND}/{cls.VERSION}"

    @classmethod
    def parse(cls, raw: Any, where: str) -> Self:
        """Check a raw mapping and build the document.

        Args:
            raw: Mapping as read from YAML or JSON.
            where: File name or address for messages.

        Raises:
            SchemaVersionError: The `schema` entry is missing, of another kind, or too new.
            ConfigError: An entry is missing, unknown or wrong.
        """
        if not isinstance(raw, dict):
            raise ConfigError(f"{where}: expected a mapping at the top, got {type(raw).__name__}")
        raw = cls._upgrade(dict(raw), where)
        return parse_model(cls, raw, where)

    @classmethod
    def _upgrade(cls, raw: Raw, where: str) -> Raw:
        name = raw.get("schema")
        if name is None:
            raise SchemaVersionError(
                f"{where}: the entry 'schema: {cls.schema_name()}' is missing; "
                f"add it as the first line if this file is a {cls.KIND} file"
            )
        kind, _, number = str(name).removeprefix("codediffuser.").partition("/")
        if kind != cls.KIND or not number.isdigit():
            raise SchemaVersionError(
                f"{where}: expected schema '{cls.schema_name()}', got '{name}'; "
                "is it the right file?"
            )
        version = int(number)
        if version > cls.VERSION:
            raise SchemaVersionError(
                f"{where}: schema '{name}' is newer than this codediffuser, which reads up to "
                f"'{cls.schema_name()}'; upgrade codediffuser"
            )
        while version < cls.VERSION:
            if version not in cls.UPGRADES:
                raise SchemaVersionError(f"{where}: schema '{name}' is no longer readable")
            raw = cls.UPGRADES[version](raw)
            version += 1
        raw["schema"] = cls.schema_name()
        return raw

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read and check one YAML or JSON file, chosen by its suffix."""
        text = _read(path, cls.KIND)
        return cls.parse(_parse_text(text, path), str(path))

    def save(self, path: Path) -> None:
        """Write YAML or JSON, chosen by the suffix; whole or not at all."""
        raw = self.model_dump(mode="json", by_alias=True)
        raw = {"schema": raw.pop("schema"), **raw}
        if path.suffix == ".json":
            write_text(path, json.dumps(raw, indent=2, ensure_ascii=False) + "\n")
        else:
            write_text(path, dump_yaml(raw))


def parse_model(model: type[M], raw: Any, where: str) -> M:
    """Build a pydantic model and turn its complaints into one `ConfigError`."""
    try:
        return model.model_validate(raw)
    except ValidationError as error:
        raise ConfigError(_explain(model, error, where)) from None


def load_yaml(path: Path) -> Any:
    """Read one YAML 1.2 file as plain dicts and lists.

    Raises:
        ConfigError: The file is missing or is not YAML; the message gives line and column.
    """
    return _parse_text(_read(path, "YAML"), path)


def dump_yaml(raw: Any) -> str:
    """Write plain dicts and lists as YAML, lists of numbers on one line."""
    yaml = YAML()
    yaml.default_flow_style = False
    yaml.width = 100
    stream = io.StringIO()
    yaml.dump(_flow_number_lists(yaml, raw), stream)
    return stream.getvalue()


def _flow_number_lists(yaml: YAML, value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _flow_number_lists(yaml, item) for key, item in value.items()}
    if isinstance(value, list):
        if all(not isinstance(item, (dict, list)) for item in value):
            sequence = yaml.seq(value)
            sequence.fa.set_flow_style()
            return sequence
        return [_flow_number_lists(yaml, item) for item in value]
    return value


def _read(path: Path, kind: str) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such {kind} file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read as a {kind} file: {error}") from None


def _parse_text(text: str, path: Path) -> Any:
    if path.suffix == ".json":
        try:
            return json.loads(text)
        except json.JSONDecodeError as error:
            raise ConfigError(
                f"{path}:{error.lineno}:{error.colno}: not JSON: {error.msg}"
            ) from None
    try:
        return YAML(typ="safe", pure=True).load(text)
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"{path}:{mark.line + 1}:{mark.column + 1}" if mark else str(path)
        problem = getattr(error, "problem", None) or "unreadable"
        raise ConfigError(f"{place}: not YAML: {problem}") from None


def _explain(model: type[BaseModel], error: ValidationError, where: str) -> str:
    lines = []
    for item in error.errors():
        key = ".".join(str(part) for part in item["loc"]) or "(top)"
        if item["type"] == "extra_forbidden":
            known = _field_names(model, item["loc"][:-1])
            close = difflib.get_close_matches(str(item["loc"][-1]), known, n=1, cutoff=0.5)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            known_text = f" Known keys: {', '.join(known)}." if known else ""
            lines.append(f"unknown key '{key}'{hint}{known_text}")
        elif item["type"] == "missing":
            lines.append(f"key '{key}' is missing")
        elif item["type"] == "value_error" and isinstance(item["input"], dict):
            # A rule about several keys names them itself; its input may be the whole document.
            prefix = "" if key == "(top)" else f"key '{key}': "
            lines.append(prefix + item["msg"].removeprefix("Value error, "))
        else:
            message = item["msg"].removeprefix("Value error, ")
            lines.append(f"key '{key}': {message}, got {item['input']!r}")
    return f"{where}: " + "; ".join(lines)


def _field_names(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Names that are allowed at a place inside `model`; empty when the place has no model."""
    current: Any = model
    for part in location:
        if isinstance(part, int):
            continue
        field = getattr(current, "model_fields", {}).get(part)
        if field is None:
            return []
        current = _model_inside(field.annotation)
        if current is None:
            return []
    return sorted(f.alias or name for name, f in current.model_fields.items())


def _model_inside(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for argument in getattr(annotation, "__args__", ()):
        found = _model_inside(argument)
        if found is not None:
            return found
    return None
