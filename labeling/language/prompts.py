"""What language models are told: the functions, the rules, and a few solved examples.

The examples are programs of the built-in composer, so they always keep the rules that they teach.
"""

from __future__ import annotations

from codediffuser.labeling.language import allowed
from codediffuser.labeling.language.composer import compose_program
from codediffuser.labeling.language.detection import compose_detection
from codediffuser.labeling.language.instances import Directions
from codediffuser.labeling.language.models import Prompt

COMPOSE_EXAMPLES = (
    "Put the left-most battery outside the crate into the slot on the back-most row.",
    "I need to use the right-most battery. Put another one into the nearest slot.",
    "Take a battery and put it in the left column, oh sorry, the middle columns.",
)
DETECT_EXAMPLES = ("battery", "green battery")
EXAMPLE_CATEGORIES = ("battery", "slot", "crate")

_RULES = """You write short Python programs that find objects in a robot's scene.
Reply with one Python program in ``` fences and nothing else.

Functions:
{functions}
An object is a dict: obj["pcd"] is an array (N, 3) of its points in metres, obj["pointer"] its
handle.
np offers: {numpy}.
Built-in functions: {builtins}.

Directions: right is {right}, left is {left}, front (toward the robot) is {front}, back is {back},
up is +z.
The middle of an object is np.mean(obj["pcd"], axis=0).

Rules: no imports, no while, try, with, class, del, f-strings or annotations; no names that begin
with an underscore; np and self are there already. Do not print.
{answer}"""

_FUNCTIONS = {
    "detect": "self.detect(phrase) -> list of the objects that a phrase names: "
    'self.detect("battery"), self.detect("green battery")',
    "get_obj": "self.get_obj(category) -> list of all objects of a category",
    "find_instance_in_category": "self.find_instance_in_category(instance=phrase, "
    "category=category) -> list of the indices into self.get_obj(category) of those that look as "
    "the phrase says",
}

_ANSWERS = {
    "compose": "Assign output_var = [object, place]: the {pick} to pick and the {place} to put it "
    "at, each an object, its pointer, or None if nothing fits the instruction.",
    "detect": "Assign output_var = the list of the objects that the phrase names.",
}


def messages(prompt: Prompt) -> list[dict[str, str]]:
    """The conversation that asks a chat model for a program.

    Returns:
        Messages with `role` and `content`: rules, solved examples, the question, and earlier
        replies each followed by what was wrong with it.
    """
    talk = [{"role": "system", "content": _rules(prompt)}]
    for question, program in _examples(prompt):
        talk.append({"role": "user", "content": question})
        talk.append({"role": "assistant", "content": f"```python\n{program}```"})
    talk.append({"role": "user", "content": _question(prompt.text, prompt.categories, prompt.kind)})
    for rejected in prompt.rejected:
        talk.append({"role": "assistant", "content": rejected.reply})
        talk.append(
            {
                "role": "user",
                "content": f"That does not work: {rejected.error}\n"
                "Reply with the whole corrected program in ``` fences.",
            }
        )
    return talk


def _rules(prompt: Prompt) -> str:
    offered = allowed.SCENE_METHODS[prompt.kind]
    right, front = prompt.directions.right, prompt.directions.front
    return _RULES.format(
        functions="\n".join(text for name, text in _FUNCTIONS.items() if name in offered),
        numpy=", ".join(sorted(allowed.NP_FUNCTIONS | allowed.NP_CONSTANTS)),
        builtins=", ".join(sorted(allowed.BUILTINS)),
        right=_direction(right),
        left=_direction((-right[0], -right[1])),
        front=_direction(front),
        back=_direction((-front[0], -front[1])),
        answer=_ANSWERS[prompt.kind].format(**{str(r): c for r, c in prompt.roles.items()}),
    )


def _direction(vector: tuple[float, float]) -> str:
    """`+x`, `-y`, or the components of a direction that is neither."""
    for axis, name in enumerate("xy"):
        if abs(abs(vector[axis]) - 1.0) < 1e-6:
            return f"{'+' if vector[axis] > 0 else '-'}{name}"
    return f"({vector[0]:.3f}, {vector[1]:.3f}) in x and y"


def _question(text: str, categories: tuple[str, ...], kind: str) -> str:
    what = "Instruction" if kind == "compose" else "Phrase"
    return f"Categories in the scene: {', '.join(categories)}\n{what}: {text}"


def _examples(prompt: Prompt) -> list[tuple[str, str]]:
    """Questions and programs; directions as in the prompt where the composer can follow them."""
    if prompt.kind == "detect":
        return [
            (_question(t, EXAMPLE_CATEGORIES, "detect"), compose_detection(t, EXAMPLE_CATEGORIES))
            for t in DETECT_EXAMPLES
        ]
    right, front = prompt.directions.right, prompt.directions.front
    along_axes = max(map(abs, right)) > 1 - 1e-6 and max(map(abs, front)) > 1 - 1e-6
    directions = prompt.directions if along_axes else Directions()
    return [
        (
            _question(text, EXAMPLE_CATEGORIES, "compose"),
            compose_program(text, EXAMPLE_CATEGORIES, directions),
        )
        for text in COMPOSE_EXAMPLES
    ]
