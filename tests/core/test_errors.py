import inspect

from codediffuser import errors
from codediffuser.errors import BelowTargetError, CodeDiffuserError, ConfigError, SchemaVersionError

ALL_ERRORS = [
    member for _, member in inspect.getmembers(errors, inspect.isclass) if member is not type
]


def test_every_error_is_of_one_tree() -> None:
    assert all(issubclass(error, CodeDiffuserError) for error in ALL_ERRORS)


def test_a_users_error_exits_with_2_and_a_missed_target_with_3() -> None:
    codes = {error.__name__: error.exit_code for error in ALL_ERRORS}
    assert codes.pop("BelowTargetError") == BelowTargetError.exit_code == 3
    assert set(codes.values()) == {2}


def test_a_wrong_schema_is_a_wrong_configuration() -> None:
    assert issubclass(SchemaVersionError, ConfigError)
