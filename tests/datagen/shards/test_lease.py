"""Leases: one holder at a time, free again when the holder is gone."""

from __future__ import annotations

import os
import pickle
import threading
import time
from pathlib import Path

import pytest

from codediffuser.datagen.shards.lease import (
    Lease,
    LeaseHeldError,
    LeaseLostError,
    holding,
    lease_path,
    release,
    renew,
    take,
)

DEAD_PID = 2**22 + 1
SHARD = "0003"


def rewrite(run: Path, **changes: object) -> None:
    path = lease_path(run, SHARD)
    Lease.load(path).model_copy(update=changes).save(path)


def test_a_lease_has_one_holder(tmp_path: Path) -> None:
    take(tmp_path, SHARD)
    with pytest.raises(LeaseHeldError, match=rf"0003: process {os.getpid()} on .* works on it"):
        take(tmp_path, SHARD)


def test_one_of_many_takers_gets_it(tmp_path: Path) -> None:
    won, start = [], threading.Barrier(8)

    def try_it() -> None:
        start.wait()
        try:
            won.append(take(tmp_path, SHARD))
        except LeaseHeldError:
            return

    threads = [threading.Thread(target=try_it) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(won) == 1
    assert Lease.load(lease_path(tmp_path, SHARD)).token == won[0]
    assert [p.name for p in lease_path(tmp_path, SHARD).parent.iterdir()] == ["0003.json"]


def test_a_lease_that_ran_out_is_taken_and_its_old_holder_notices(tmp_path: Path) -> None:
    old = take(tmp_path, SHARD)
    rewrite(tmp_path, expires_s=time.time() - 1)
    new = take(tmp_path, SHARD)
    with pytest.raises(LeaseLostError, match="taken by another"):
        renew(tmp_path, SHARD, old)
    release(tmp_path, SHARD, old)
    assert Lease.load(lease_path(tmp_path, SHARD)).token == new


def test_the_lease_of_a_dead_process_of_this_machine_is_free_at_once(tmp_path: Path) -> None:
    take(tmp_path, SHARD)
    rewrite(tmp_path, pid=DEAD_PID)
    take(tmp_path, SHARD)


def test_the_lease_of_a_process_of_another_machine_is_waited_for(tmp_path: Path) -> None:
    take(tmp_path, SHARD, lease_s=30)
    rewrite(tmp_path, pid=DEAD_PID, machine="elsewhere")
    with pytest.raises(LeaseHeldError) as caught:
        take(tmp_path, SHARD)
    assert 25 < caught.value.left_s <= 30


def test_a_held_lease_is_renewed_and_given_back(tmp_path: Path) -> None:
    with holding(tmp_path, SHARD, lease_s=0.3) as lost:
        first = Lease.load(lease_path(tmp_path, SHARD)).expires_s
        deadline = time.monotonic() + 20
        while Lease.load(lease_path(tmp_path, SHARD)).expires_s == first:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        assert not lost.is_set()
    assert not lease_path(tmp_path, SHARD).exists()


def test_a_holder_is_told_of_a_loss_and_leaves_the_new_holder_alone(tmp_path: Path) -> None:
    with holding(tmp_path, SHARD, lease_s=0.3) as lost:
        rewrite(tmp_path, token="somebody else", expires_s=time.time() + 60)
        assert lost.wait(20)
    assert Lease.load(lease_path(tmp_path, SHARD)).token == "somebody else"


def test_the_error_survives_the_way_from_another_process() -> None:
    error = pickle.loads(pickle.dumps(LeaseHeldError(SHARD, "process 1 on a", 12.5)))
    assert error.left_s == 12.5
    assert "process 1 on a works on it for at least 12 s more" in str(error)
