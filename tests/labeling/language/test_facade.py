from __future__ import annotations

import numpy as np
import pytest

from codediffuser.labeling.language import allowed
from codediffuser.labeling.language.facade import MAX_ELEMENTS, MAX_ROWS, Array, Facade


@pytest.fixture
def facade() -> Facade:
    return Facade()


def test_every_offered_function_exists_in_numpy(facade: Facade) -> None:
    for name in allowed.NP_FUNCTIONS:
        with pytest.raises((TypeError, ValueError)):
            facade.call(f"np.{name}", ({"no": "numbers"},), {})


def test_scalars_come_back_plain_and_arrays_as_handles(facade: Facade) -> None:
    handle = facade.wrap(np.arange(6.0).reshape(2, 3))
    assert type(facade.call("np.mean", (handle,), {})) is float
    assert type(facade.call("np.argmax", (handle,), {})) is int
    means = facade.call("np.mean", (handle,), {"axis": 0})
    assert isinstance(means, Array) and means.values.tolist() == [1.5, 2.5, 3.5]
    assert means.serial != handle.serial


TOO_LARGE = {
    "zeros": ("np.zeros", (10**9,)),
    "ones of a shape": ("np.ones", ((10**5, 10**5),)),
    "linspace": ("np.linspace", (0, 1, 10**9)),
    "arange": ("np.arange", (10**12,)),
    "outer sum": ("add", ("column", "row")),
    "outer where": ("np.where", ("column", "row", 0.0)),
    "outer product": ("np.dot", ("column", "row")),
    "stack of the same": ("np.stack", (["row"] * 500,)),
    "array of the same": ("np.array", (["row"] * 500,)),
    "repeated rows": ("get", ("wide", [0] * 2_000)),
}


@pytest.mark.parametrize("case", TOO_LARGE)
def test_results_that_would_be_huge_are_refused_before_they_are_made(
    case: str, facade: Facade
) -> None:
    known = {
        "row": facade.wrap(np.zeros((1, 5_000))),
        "column": facade.wrap(np.zeros((5_000, 1))),
        "wide": facade.wrap(np.zeros((2, 5_000))),
    }

    def fill(value: object) -> object:
        if isinstance(value, list):
            return [fill(v) for v in value]
        return known.get(value, value) if isinstance(value, str) else value

    name, args = TOO_LARGE[case]
    with pytest.raises(MemoryError, match="limited to"):
        facade.call(name, tuple(fill(a) for a in args), {})


def test_the_total_of_all_arrays_is_limited(facade: Facade) -> None:
    handle = facade.wrap(np.zeros(MAX_ELEMENTS))
    with pytest.raises(MemoryError):
        for _ in range(20):
            facade.call("neg", (handle,), {})


def test_loops_over_long_arrays_are_refused(facade: Facade) -> None:
    with pytest.raises(MemoryError, match=str(MAX_ROWS)):
        facade.call("rows", (facade.wrap(np.zeros((MAX_ROWS + 1, 3))),), {})


@pytest.mark.parametrize("name", ["np.load", "np.fromfile", "np.save", "np.core", "np.__doc__"])
def test_the_rest_of_numpy_is_out_of_reach(name: str, facade: Facade) -> None:
    with pytest.raises(TypeError, match="not offered"):
        facade.call(name, ("x",), {})


@pytest.mark.parametrize("name", ["tofile", "dump", "ctypes", "__class__", "data", "view"])
def test_the_rest_of_arrays_is_out_of_reach(name: str, facade: Facade) -> None:
    handle = facade.wrap(np.zeros(3))
    with pytest.raises(TypeError):
        facade.call("method", (name, handle), {})
    with pytest.raises(AttributeError):
        facade.call("attr", (handle, name), {})


@pytest.mark.parametrize("value", ["text", {"a": 1}, b"x", object(), 2**70, [[[[[[1]]]]]], {1}])
def test_arguments_other_than_numbers_are_refused(value: object, facade: Facade) -> None:
    with pytest.raises((TypeError, OverflowError)):
        facade.call("np.array", (value,), {})
