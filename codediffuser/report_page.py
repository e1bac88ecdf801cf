"""One self-contained HTML page: no script, style, font or picture from elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

STYLE = Path(__file__).with_name("report.css")


def render_page(template: Path, **values: Any) -> str:
    """Fill a template; `style` in it is the look that all reports share.

    Everything is escaped unless it is `markup`: names and sentences come from people and models.
    """
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    page = environment.from_string(template.read_text(encoding="utf-8"))
    return page.render(style=markup(STYLE.read_text(encoding="utf-8")), **values)


def markup(text: str) -> Any:
    """Mark text of our own as HTML, to be written as it is."""
    from markupsafe import Markup

    return Markup(text)
