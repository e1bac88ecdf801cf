"""The verbs of the command line, one file each, in the order of the pipeline.

A verb is a dataclass whose fields are its options. `run` calls one function of its stage, shows
progress, and returns what the command prints last.
"""

from codediffuser.verbs.convert import Convert
from codediffuser.verbs.demo import Demo
from codediffuser.verbs.doctor import Doctor
from codediffuser.verbs.eval import Eval
from codediffuser.verbs.import_ import Import
from codediffuser.verbs.inspect import Inspect
from codediffuser.verbs.label import Label
from codediffuser.verbs.merge import Merge
from codediffuser.verbs.quickstart import Quickstart
from codediffuser.verbs.sample import Sample
from codediffuser.verbs.train import Train
from codediffuser.verbs.validate import Validate
from codediffuser.verbs.verb import Verb

VERBS: dict[str, type[Verb]] = {
    "sample": Sample,
    "demo": Demo,
    "import": Import,
    "label": Label,
    "convert": Convert,
    "merge": Merge,
    "validate": Validate,
    "inspect": Inspect,
    "train": Train,
    "eval": Eval,
    "doctor": Doctor,
    "quickstart": Quickstart,
}

__all__ = ["VERBS", "Verb"]
