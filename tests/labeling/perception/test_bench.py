from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from codediffuser.datagen.task_config import ClusterConfig, Workspace
from codediffuser.labeling.perception.bench import CloudBench, open3d_chain, our_chain, report
from codediffuser.labeling.perception.cloud import CloudFuser
from codediffuser.labeling.perception.views import View

WORKSPACE = Workspace(low_m=(-0.2, -0.2, 0.002), high_m=(0.2, 0.2, 0.3))


def test_both_chains_do_the_same_work(make_views: Callable[..., tuple[View, ...]]) -> None:
    views, config = make_views(5, 320, 240), ClusterConfig(eps_m=0.01)
    fuser = CloudFuser(WORKSPACE.low_m, WORKSPACE.high_m, drop_flying=False)
    ours = our_chain(views, fuser=fuser, config=config)
    theirs = open3d_chain(views, workspace=WORKSPACE, config=config)
    assert ours.points == theirs.points > 8000
    assert len(ours.even) == len(theirs.even) == 8000
    assert ours.clusters == theirs.clusters == 1
    # Farthest point samples from two starts cover the same surface equally well.
    for one, other in ((ours, theirs), (theirs, ours)):
        assert cKDTree(one.even).query(other.even)[0].max() < 0.003


def test_the_report_names_stages_and_ratio(make_views: Callable[..., tuple[View, ...]]) -> None:
    views, config = make_views(2), ClusterConfig(eps_m=0.01)
    fuser = CloudFuser(WORKSPACE.low_m, WORKSPACE.high_m)
    ours = our_chain(views, fuser=fuser, config=config)
    theirs = open3d_chain(views, workspace=WORKSPACE, config=config)
    result = CloudBench((2, 60, 80), (ours,), (theirs,))
    assert np.isclose(result.ratio, sum(theirs.seconds) / sum(ours.seconds))
    text = report(result)
    assert "1 frames, 2 views of 80x60" in text
    assert "fuse and crop" in text and f"{result.ratio:.1f} times faster" in text
