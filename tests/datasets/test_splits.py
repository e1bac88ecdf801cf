"""Which side an episode falls on is decided by its id alone."""

from __future__ import annotations

import pytest

from codediffuser.datasets.splits import episode_fraction, split_episodes
from codediffuser.errors import ConfigError

IDS = [f"{i:06d}" for i in range(400)]


def test_the_two_sides_are_disjoint_and_complete() -> None:
    train, val = split_episodes(IDS)
    assert sorted(train + val) == list(range(400))
    assert 20 <= len(val) <= 60


def test_order_and_company_move_no_episode() -> None:
    _, val = split_episodes(IDS)
    held_out = {IDS[i] for i in val}
    some = IDS[::-1][:150]
    _, val_of_some = split_episodes(some)
    assert {some[i] for i in val_of_some} == held_out & set(some)


def test_a_larger_share_only_adds_to_the_held_out() -> None:
    _, small = split_episodes(IDS, 0.1)
    _, large = split_episodes(IDS, 0.3)
    assert set(small) < set(large)


def test_the_split_never_changes_between_versions() -> None:
    assert split_episodes(IDS[:30], 0.1)[1] == [14]
    assert episode_fraction("000000") == pytest.approx(0.6953, abs=0.0001)


def test_no_share_holds_nothing_out() -> None:
    assert split_episodes(IDS[:5], 0.0) == ([0, 1, 2, 3, 4], [])


@pytest.mark.parametrize("count", [2, 3, 5])
def test_both_sides_of_few_episodes_have_one(count: int) -> None:
    for share in (0.01, 0.99):
        train, val = split_episodes(IDS[:count], share)
        assert train and val


def test_none_and_one_episode_train() -> None:
    assert split_episodes([]) == ([], [])
    for name in IDS[:30]:
        assert split_episodes([name], 0.5) == ([0], [])


@pytest.mark.parametrize("share", [-0.1, 1.0, 7])
def test_impossible_shares_are_refused(share: float) -> None:
    with pytest.raises(ConfigError, match="val_share"):
        split_episodes(IDS, share)
