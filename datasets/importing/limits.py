"""Refuses episodes that are beyond the limits of the configuration, with the reason."""

from __future__ import annotations

from codediffuser.datasets.importing.bag_sync import SyncedEpisode
from codediffuser.datasets.importing.config import Limits


def refusal(synced: SyncedEpisode, num_steps: int, limits: Limits) -> str:
    """Why an episode is refused; empty when it is within all limits."""
    plan = synced.plan
    if num_steps < limits.min_frames:
        return f"{num_steps} frames, below min_frames {limits.min_frames}"
    for what, count, limit in (
        ("dropped", plan.num_dropped, limits.max_dropped_share),
        ("held", plan.num_held, limits.max_held_share),
    ):
        share = count / max(plan.num_candidates, 1)
        if share > limit:
            counts = plan.dropped if what == "dropped" else plan.held
            worst = max(counts, key=lambda name: counts[name])
            return (
                f"{share:.1%} of the frames are {what}, above max_{what}_share {limit:.1%}; most "
                f"because of {worst}"
            )
    for name, sync in synced.record.signals.items():
        if sync.method != "next" and sync.skew_p95_ms > limits.max_skew_p95_s * 1000:
            return (
                f"{name}: skew p95 is {sync.skew_p95_ms:.0f} ms, above max_skew_p95_s "
                f"{limits.max_skew_p95_s}"
            )
    for topic, share in synced.missing_share.items():
        if share > limits.max_missing_share:
            return (
                f"{share:.1%} of the messages of '{topic}' are missing, above max_missing_share "
                f"{limits.max_missing_share:.1%}"
            )
    return ""
