"""Lines of programs that keep the places beside or between other things."""

from __future__ import annotations

from collections.abc import Sequence

from codediffuser.labeling.language.meaning import Relation


def relation_lines(
    relation: Relation, anchors: Sequence[str], name: str, source: str, right: tuple[int, int]
) -> list[str]:
    """Narrow a list of places down to those that a relation means.

    An anchor that is missing, or is more than one thing, leaves no place: NaN is near nothing.

    Args:
        relation: What is meant.
        anchors: Names of lists, one for each anchor, that should hold one thing each.
        name: Name of the list to write.
        source: Name of the list to narrow down.
        right: World axis and sign of the observer's right.
    """
    axis, sign = right
    along = f'np.mean(obj["pcd"], axis=0)[{axis}]'
    lines = []
    for number, anchor in enumerate(anchors):
        lines += [
            f"at_{number} = np.nan",
            f"for obj in {anchor}:",
            f"    at_{number} = {along} if len({anchor}) == 1 else np.nan",
        ]
    if len(anchors) == 2:
        low, high = "np.minimum(at_0, at_1)", "np.maximum(at_0, at_1)"
        return [
            *lines,
            f"low, high = {low}, {high}",
            f"{name} = [obj for obj in {source} if low < {along} < high]",
        ]
    upward = relation.side is not None and (relation.side == "right") == (sign > 0)
    low = high = "at_0"
    if relation.side is None or not upward:
        low = _neighbour("-np.inf", "<", "max", along, lines) if relation.adjacent else "-np.inf"
    if relation.side is None or upward:
        high = _neighbour("np.inf", ">", "min", along, lines) if relation.adjacent else "np.inf"
    test = f"{low} < {along} < {high}"
    if relation.side is None:
        test += " and at_0 == at_0"
    return [*lines, f"{name} = [obj for obj in {source} if {test}]"]


def _neighbour(none: str, relation: str, best: str, along: str, lines: list[str]) -> str:
    """Write where the next thing in the row stands, seen from the anchor; the name of that."""
    name = "before" if relation == "<" else "behind"
    lines += [
        f"{name}_list = [{along} for obj in row_list if {along} {relation} at_0]",
        f"{name} = np.{best}({name}_list) if len({name}_list) > 0 else {none}",
    ]
    return name
