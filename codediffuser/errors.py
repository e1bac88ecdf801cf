"""One tree of errors, each telling what was expected, what came, where, and what to try.

The command line turns every `CodeDiffuserError` into one line on stderr and exit code 2;
any other exception is a bug of ours and exits with 1.
"""

from __future__ import annotations


class CodeDiffuserError(Exception):
    """Base of everything that a user can cause or mend."""

    exit_code = 2


class ConfigError(CodeDiffuserError):
    """A configuration file or option does not say what it should."""


class SchemaVersionError(ConfigError):
    """A file's `schema:` line names another kind or a version that this code cannot read."""


class NotRegisteredError(CodeDiffuserError):
    """A name is not in its registry."""


class ShapeError(CodeDiffuserError):
    """An array does not have the shape or dtype that its contract states."""


class PlacementError(CodeDiffuserError):
    """Objects cannot be placed within their ranges and clearances."""


class PlanningError(CodeDiffuserError):
    """A commanded pose cannot be reached."""


class RenderError(CodeDiffuserError):
    """No picture can be made, or a camera sees nothing."""


class EpisodeError(CodeDiffuserError):
    """An episode folder is damaged, unfinished or of another kind."""


class InstructionError(CodeDiffuserError):
    """An instruction cannot be understood, or fits nothing in its scene."""


class ProgramError(CodeDiffuserError):
    """A generated program is not allowed, fails, or answers with something that is no target."""


class LanguageModelError(CodeDiffuserError):
    """A language model gives no answer: the server is away, refuses, or sends something else."""


class LabelError(CodeDiffuserError):
    """A label is missing, damaged or does not belong to its episode."""


class StaleLabelError(LabelError):
    """Somebody else changed an episode's labels first; nothing was overwritten."""


class DatasetError(CodeDiffuserError):
    """A dataset does not follow its contract."""


class CheckpointError(CodeDiffuserError):
    """A checkpoint is missing, damaged or belongs to another policy."""


class SetupError(CodeDiffuserError):
    """The machine lacks something that the command needs."""


class StorageError(CodeDiffuserError):
    """A disk is full, or a quota is used up."""


class BelowTargetError(CodeDiffuserError):
    """The work finished, but below the success that was asked for."""

    exit_code = 3


class FindingsError(CodeDiffuserError):
    """A validation found something wrong."""

    exit_code = 3
