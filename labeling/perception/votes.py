"""Points that vote for the middle of their instance, parted by where the votes gather.

Where things touch, their points do not part but their middles lie apart. Votes are taken greedily:
the densest gathering is an instance, what votes for it is taken away, and so on. Gatherings nearer
to a denser one than two middles can be are the stragglers of its votes.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from codediffuser.labeling.perception.clustering import NOISE
from codediffuser.pointcloud import check_points

CELLS_PER_REACH = 5
"""Votes are counted in cells this much smaller than the reach."""
ROUNDS = 5
"""Of moving a gathering's middle to the mean of the votes around it."""
MAX_REACHES = 3.0
"""Votes this many reaches from their nearest middle still belong to it, since no other claims
them; farther ones belong to nothing."""


def gather_votes(
    middles_world: np.ndarray, reach_m: float, min_points: int, min_share: float
) -> tuple[np.ndarray, np.ndarray]:
    """Part points by the middles that they vote for.

    Args:
        middles_world: (N, 3) float, metres; N may be 0.
        reach_m: Votes this near to a gathering's middle are votes for it: below half the distance
            between the middles of two instances.
        min_points: Gatherings of fewer votes are dropped.
        min_share: So are those of fewer than this share of the median gathering's.

    Returns:
        instance: (N,) int64, `NOISE` or the row of `middles`.
        middles: (n, 3) float64, metres, in lexicographic order.
    """
    check_points(middles_world, "middles_world")
    if len(middles_world) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    cells, counts = _cells(middles_world, reach_m / CELLS_PER_REACH)
    middles, sizes = _peaks(cells, counts, reach_m, min_points)
    kept = sizes >= min_share * np.median(sizes) if len(sizes) else np.zeros(0, dtype=bool)
    middles = middles[kept]
    middles = middles[np.lexsort(middles.T[::-1])]
    instance = np.full(len(middles_world), NOISE, dtype=np.int64)
    if len(middles):
        distance, nearest = cKDTree(middles).query(middles_world)
        mine = distance <= MAX_REACHES * reach_m
        instance[mine] = nearest[mine]
    return instance, middles


def _cells(votes: np.ndarray, size_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean (M, 3) and number (M,) of the votes in each cell that has any."""
    index = np.floor(votes / size_m).astype(np.int64)
    _, cell, counts = np.unique(index, axis=0, return_inverse=True, return_counts=True)
    cell = cell.reshape(-1)
    sums = np.stack([np.bincount(cell, weights=votes[:, a]) for a in range(3)], axis=-1)
    return sums / counts[:, None], counts


def _peaks(
    cells: np.ndarray, counts: np.ndarray, reach_m: float, min_points: int
) -> tuple[np.ndarray, np.ndarray]:
    """Middles (n, 3) of the gatherings and how many votes each has, densest first."""
    tree = cKDTree(cells)
    near = tree.query_ball_point(cells, reach_m / 2)
    density = np.array([counts[n].sum() for n in near])
    left = counts.astype(np.float64)
    middles: list[np.ndarray] = []
    sizes: list[float] = []
    for start in np.argsort(-density, kind="stable"):
        if density[start] < min_points / 2:
            break
        if _too_near(cells[start], middles, reach_m):
            continue
        middle = _settled(cells[start], cells, left, tree, reach_m)
        if _too_near(middle, middles, reach_m):
            continue
        around = np.array(tree.query_ball_point(middle, reach_m), dtype=np.intp)
        size = left[around].sum()
        left[around] = 0.0
        if size >= min_points:
            middles.append(middle)
            sizes.append(float(size))
    return np.array(middles).reshape(-1, 3), np.array(sizes)


def _too_near(middle: np.ndarray, others: list[np.ndarray], reach_m: float) -> bool:
    """Whether a middle lies so near to another that both are of one instance."""
    if not others:
        return False
    return bool((np.linalg.norm(np.array(others) - middle, axis=1) < 2 * reach_m).any())


def _settled(
    middle: np.ndarray, cells: np.ndarray, left: np.ndarray, tree: cKDTree, reach_m: float
) -> np.ndarray:
    """Move a middle (3,) to the mean of the votes around it, a few times."""
    for _ in range(ROUNDS):
        around = np.array(tree.query_ball_point(middle, reach_m), dtype=np.intp)
        if left[around].sum() == 0:
            break
        middle = np.average(cells[around], axis=0, weights=left[around])
    return middle
