"""From a sentence to an object and a place, by a program that never meets the interpreter.

python examples/04_words_to_targets.py "Pick the left-most battery and place it in the slot."
"""

from __future__ import annotations

from typing import Annotated

import tyro

from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.task import get_task
from codediffuser.errors import ProgramError
from codediffuser.labeling.language import ground, simulated_provider
from codediffuser.labeling.language.checker import check_program


def main(
    sentence: Annotated[str, tyro.conf.Positional] = "",
    task: str = "pack_battery",
    index: int = 3,
) -> None:
    """Ground a sentence, or the scene's own, and show what a hostile program comes to."""
    scene = sample_scene(get_task(task), root_seed=0, index=index)
    found = ground(sentence or scene.instruction.text, simulated_provider(scene))
    print(found.instruction)
    print("\n".join("    " + line for line in found.program.splitlines()))
    for call in found.calls:
        print(f"  {call.function}{call.arguments} found {len(call.result)}")
    print("pick:", found.target("pick"), " place:", found.target("place"))

    try:
        check_program("import os\noutput_var = os.listdir('/')", "compose")
    except ProgramError as error:
        print("refused:", error)


if __name__ == "__main__":
    tyro.cli(main)
