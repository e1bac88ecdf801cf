"""Language to attention: instruction -> program -> which object to pick and where to place it.

    from codediffuser.labeling.language import ground, simulated_provider

    grounding = ground("Put the left-most battery in the nearest slot.", simulated_provider(scene))
    grounding.target("pick"), grounding.target("place")   # ids of the scene
    grounding.program                                     # the program that found them

A language model, or the built-in composer, writes a short program over three scene functions and
NumPy-like selections (`self.detect("slot")`, `np.argmin(...)`), as in the paper's supplement,
sections I.B and I.C. Phrases that the program wants detected become programs of their own.

**The guarantee.** A generated program never meets the host interpreter. Nothing here calls `exec`
or `eval`; no object of the host is reachable from a program; every answer is one of the instances
that the scene has, or an error. Whatever is wrong ends as one `CodeDiffuserError` within seconds.

The layers, from the outside in:

1. *Extraction* (`models.extract_program`): code out of a reply, whatever surrounds it.
2. *Checker* (`checker`, tables in `allowed`): parses and lets through only listed syntax, names,
   functions, methods and attributes, within size and depth limits. No imports, no dunders, no
   `getattr`, no text formatting, no `while`. Its messages give line, column and remedy, and go back
   to the model for one repair round.
3. *Lowering* (`lowering`, `prelude`): operators that could meet an array become function calls, so
   arrays can be handles. Meaning stays that of Python and NumPy.
4. *Sandbox* (`sandbox`): `pydantic-monty`, an interpreter written in Rust in a process of its own,
   with limits of time, memory, recursion and calls. Inside are numbers, text, lists, dicts and
   opaque handles that carry a serial number and nothing else.
5. *Facade* (`facade`): array work asked for by the program, done by the host under judgement of
   function, options, types and sizes, within a total budget.
6. *Answer* (`grounding`): [pick, place], each an instance of the right category that the program
   was given. None for one of them means that nothing fits: `InstructionError`.

The words: `vocabulary` (a task's nouns, from its YAML), `lexicon` and `tokens` (all other words),
`phrases` and `grammar` (meaning of an instruction, `meaning`), `composer` (meaning -> program).
Directions are those of an observer at the robot: right = +x, left = -x, front/near = -y,
back/far = +y, unless the provider says otherwise.
"""

from codediffuser.labeling.language.grounding import ApiCall, Attempt, Grounding, ground
from codediffuser.labeling.language.instances import (
    Directions,
    Instance,
    InstanceProvider,
    ListedInstances,
)
from codediffuser.labeling.language.models import LANGUAGE_MODELS, LanguageModel, Prompt, get_model
from codediffuser.labeling.language.sandbox import Limits
from codediffuser.labeling.language.simulated import simulated_provider
from codediffuser.labeling.language.vocabulary import Vocabulary

__all__ = [
    "LANGUAGE_MODELS",
    "ApiCall",
    "Attempt",
    "Directions",
    "Grounding",
    "Instance",
    "InstanceProvider",
    "LanguageModel",
    "Limits",
    "ListedInstances",
    "Prompt",
    "Vocabulary",
    "get_model",
    "ground",
    "simulated_provider",
]
