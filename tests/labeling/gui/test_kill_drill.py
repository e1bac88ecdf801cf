"""A server killed at random moments loses nothing that it had said was saved."""

from __future__ import annotations

from pathlib import Path

import pytest

from codediffuser.labeling.gui.kill_drill import drill


@pytest.mark.parametrize("kills", [2, pytest.param(50, marks=pytest.mark.slow)])
def test_no_acknowledged_action_is_lost(run: Path, kills: int) -> None:
    result = drill(run, kills=kills)
    assert result.lost == [] and result.kills == kills
    assert result.acknowledged > kills
