"""Keys, and sentences that may hold anything that data says."""

from __future__ import annotations

import html
from collections.abc import Callable
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from codediffuser.errors import ConfigError
from codediffuser.labeling.gui.access import check_access
from codediffuser.labeling.gui.app import LocalServer
from codediffuser.labeling.gui.keys import KEYS, Action
from codediffuser.labeling.gui.session import Session
from codediffuser.labeling.gui.texts import escape, headline, keys_table, notes

CAMERA_KEYS = {"W", "A", "S", "D", "Q", "E"}
MARKUP = ("<", ">", '"', "'")


def test_every_action_has_one_key_and_none_moves_the_camera() -> None:
    assert sorted(key.action for key in KEYS) == sorted(get_args(Action))
    hotkeys = [key.hotkey for key in KEYS]
    assert len(hotkeys) == len(set(hotkeys))
    assert not CAMERA_KEYS & set(hotkeys) and not any("arrow" in key for key in hotkeys)


def test_the_help_panel_lists_every_key() -> None:
    assert all(f"**{key.hotkey.capitalize()}** | {key.label}" in keys_table() for key in KEYS)


@given(st.text(max_size=60))
def test_escaped_text_is_no_markup_and_reads_the_same(text: str) -> None:
    escaped = escape(text)
    assert not any(sign in escaped for sign in MARKUP)
    assert html.unescape(escaped) == text or "\r" in text or "\x00" in text
    assert html.unescape(escape('Put Ada\'s mug on "A & B"')) == 'Put Ada\'s mug on "A & B"'


@pytest.mark.parametrize(
    "text",
    [
        "<script>alert(1)</script>",
        "**bold**",
        "[a](javascript:x)",
        "![x](http://a/b.png)",
        "`code`",
    ],
)
def test_markdown_sees_no_markup_in_escaped_text(text: str) -> None:
    rendered = MarkdownIt("commonmark", {"html": True}).render(escape(text))
    for tag in ("<script", "<strong", "<a ", "<img", "<code"):
        assert tag not in rendered


def test_what_data_says_reaches_the_panel_escaped(sit_down: Callable[..., Session]) -> None:
    session = sit_down("<b>ada</b>")
    session.flag("<img src=x onerror=alert(1)>")
    session.problem = "<i>broken</i>"
    for text in (headline(session), notes(session, "<u>note</u>")):
        assert not any(tag in text for tag in ("<b>", "<img", "<i>", "<u>"))
    assert "<img src=x" in html.unescape(headline(session))
    assert "<i>broken</i>" in html.unescape(notes(session, ""))


def test_other_machines_need_a_token() -> None:
    check_access("127.0.0.1", None)
    check_access("0.0.0.0", "a long enough token")
    with pytest.raises(ConfigError, match=r"a token is required: set .*CODEDIFFUSER_LABEL_TOKEN"):
        check_access("0.0.0.0", None)
    with pytest.raises(ConfigError, match="expected at least 8"):
        check_access("127.0.0.1", "short")


def test_no_client_opens_a_public_tunnel() -> None:
    server = LocalServer(host="127.0.0.1", port=0, verbose=False)
    try:
        assert server.request_share_url() is None and server.get_host() == "127.0.0.1"
    finally:
        server.stop()
