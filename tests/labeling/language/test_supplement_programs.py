"""The example programs of the paper's supplement, I.B and I.C, word for word.

Only what the extraction from the PDF broke is mended: indentation, line breaks, `tqt` for `tgt`.
"""

from __future__ import annotations

import pytest

from codediffuser.labeling.language.grounding import ground
from codediffuser.labeling.language.instances import Instance, ListedInstances

SPATIAL = """
# Determine target object, battery
battery = self.detect("battery")[0]["pointer"]
# Determine target object, the slot on the middle column
# Detect slots
slot_list = self.detect("slot")
slot_centroid_list = []
for obj in slot_list:
    slot_centroid_list.append(np.mean(obj["pcd"], axis=0)[np.newaxis, :])
slot_centroid_numpy = np.concatenate(slot_centroid_list, axis=0)
# Extract x coordinate
slot_x = slot_centroid_numpy[:, 0] # use x to determine right or left
# The slot with the max x value and the min x value
slot_max_x = np.max(slot_x)
slot_min_x = np.min(slot_x)
# Determine the x coordinate range for the middle column
middle_x_threshold = (slot_max_x + slot_min_x) / 2
# Find the index of the slot closest to the middle_x_threshold
tgt_slot_idx = np.argmin(np.abs(slot_x - middle_x_threshold))
# Extract the points of the target slot
tgt_slot = slot_list[tgt_slot_idx]["pointer"]
output_var = [battery, tgt_slot]
"""

VISUAL = """
# determine target object, the other mug (not blue)
blue_mug = self.detect("blue mug")[0]
mug_list = self.detect("mug")
tgt_mug_list = []
for mug in mug_list:
    if mug != blue_mug:
        tgt_mug_list.append(mug)
tgt_mug = tgt_mug_list[0]["pointer"]
# determine target object, branch
branch = self.detect("branch")[0]["pointer"]
output_var = [tgt_mug, branch]
"""

BLUE_MUG = """
mug_list = self.get_obj('mug')
tgt_idx = self.find_instance_in_category(instance = 'blue mug', category = 'mug')
tgt_mug = []
for i in tgt_idx:
    tgt_mug.append(mug_list[i])
output_var = tgt_mug
"""


def get_all(category: str) -> str:
    return f"{category}_list = self.get_obj('{category}')\noutput_var = {category}_list\n"


def test_spatial_selection(make_scene, scripted) -> None:
    instruction = "Pick a battery into the slot on the middle columns."
    model = scripted({instruction: SPATIAL, "battery": get_all("battery"), "slot": get_all("slot")})
    # Free slots 3, 6, 8: columns 3, 2 and 0. The middle of their range lies nearest to column 2.
    scene = make_scene({"b": (0.0, 0.0)}, taken=[0, 1, 2, 4, 5, 7, 9, 10, 11])
    grounding = ground(instruction, scene, model)
    assert grounding.targets == (("pick", "b"), ("place", "slot_6"))
    assert grounding.program == SPATIAL.lstrip("\n")
    assert [(c.function, c.arguments) for c in grounding.calls] == [
        ("get_obj", ("battery",)),
        ("detect", ("battery",)),
        ("get_obj", ("slot",)),
        ("detect", ("slot",)),
    ]


@pytest.mark.parametrize("blue", [0, 1])
def test_visual_selection_through_nested_detection(blue: int, box, scripted) -> None:
    colors = ["red", "red"]
    colors[blue] = "blue"
    mugs = [
        Instance(f"m{i}", "mug", f"{c} mug", box((0.1 * i, 0, 0))) for i, c in enumerate(colors)
    ]
    branches = [Instance(f"t{i}", "branch", "branch", box((0, 0.1 * i, 0.2))) for i in range(2)]
    scene = ListedInstances(mugs + branches, {"pick": "mug", "place": "branch"})
    instruction = (
        "I want to use the blue mug to drink some water. Put away the other one on a branch."
    )
    model = scripted(
        {
            instruction: VISUAL,
            "blue mug": BLUE_MUG,
            "mug": get_all("mug"),
            "branch": get_all("branch"),
        }
    )
    grounding = ground(instruction, scene, model)
    assert grounding.targets == (("pick", f"m{1 - blue}"), ("place", "t0"))
    finds = [c for c in grounding.calls if c.function == "find_instance_in_category"]
    assert [(c.arguments, c.result) for c in finds] == [(("blue mug", "mug"), (f"m{blue}",))]
    assert [a.kind for a in grounding.attempts] == ["detect", "detect", "detect", "compose"]
