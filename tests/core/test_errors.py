import inspect

from codediffuser import errors
from codediffuser.errors import CodeDiffuserError, ConfigError, SchemaVersionError

ALL_ERRORS = [
    member for _, member in inspect.getmembers(errors, inspect.isclass) if member is not type
]


def test_every_error_is_of_one_tree() -> None:
    assert all(issubclass(error, CodeDiffuserError) for error in ALL_ERRORS)


FINISHED_BUT_NOT_WELL = {"BelowTargetError", "FindingsError"}


def test_work_that_ended_badly_exits_with_3_and_everything_else_with_2() -> None:
    for error in ALL_ERRORS:
        assert error.exit_code == (3 if error.__name__ in FINISHED_BUT_NOT_WELL else 2), error


def test_a_wrong_schema_is_a_wrong_configuration() -> None:
    assert issubclass(SchemaVersionError, ConfigError)
