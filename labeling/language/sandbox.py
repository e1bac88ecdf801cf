"""Run a checked program in `pydantic-monty`: another interpreter, in another process.

The program sees numbers, text, lists, dicts and opaque handles, never a host object. It can call
back for three scene functions and for array work; each call is judged here. Time, memory,
recursion and calls are limited. What it answers is judged too: only instances that the scene has.
"""

from __future__ import annotations

import atexit
import os
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import pydantic_monty as monty

from codediffuser.errors import ProgramError, SetupError
from codediffuser.labeling.language.allowed import SCENE_METHODS
from codediffuser.labeling.language.checker import RESULT, CheckedProgram
from codediffuser.labeling.language.facade import Array, Facade
from codediffuser.labeling.language.instances import Instance
from codediffuser.labeling.language.lowering import HOST, LoweredProgram, lower_program
from codediffuser.labeling.language.prelude import PRELUDE

MAX_PHRASE = 200
"""Characters of a phrase that a program may ask for."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What one program may use up."""

    seconds: float = 1.0
    """Of the sandbox's own work, and again of processor time for array work on its behalf."""
    memory_bytes: int = 32 * 2**20
    recursion: int = 100
    calls: int = 2_000
    """Calls to the host; an ordinary program makes about a hundred."""


@dataclass(frozen=True, slots=True)
class SceneApi:
    """What `self` can do in a program; perception and language models stand behind it."""

    detect: Callable[[str], Sequence[Instance]]
    """Phrase to instances; may run another program."""
    get_obj: Callable[[str], Sequence[Instance]]
    """Category to all its instances."""
    find_instance_in_category: Callable[[str, str], Sequence[int]]
    """Phrase and category to indices into `get_obj(category)`."""


class Pointer:
    """Opaque handle of one instance. The sandbox sees only its serial number."""

    __slots__ = ("instance", "serial")

    def __init__(self, instance: Instance, serial: int) -> None:
        self.instance = instance
        self.serial = serial


def run_program(
    program: CheckedProgram, api: SceneApi, limits: Limits | None = None
) -> list[Instance | None]:
    """Run a program and return what it answers with.

    Args:
        program: From `check_program`.
        api: What `self` does. Errors of the toolkit that it raises come out unchanged.
        limits: None takes the defaults.

    Returns:
        The items of `output_var`, each an instance, or None for what was not found.

    Raises:
        ProgramError: The program fails, meets a limit, or answers with something else.
    """
    limits = limits or Limits()
    lowered = lower_program(program)
    host = _Host(program, api, limits)
    # One program may run inside another's call; each depth has its own workers, so that outer
    # programs that wait never hold all the workers that inner ones need.
    pool = _POOLS.get(_DEPTH.value)
    _DEPTH.value += 1
    try:
        output = _run(pool, lowered, host, limits)
    finally:
        _DEPTH.value -= 1
    return host.instances(output)


def _run(pool: monty.Monty, lowered: LoweredProgram, host: _Host, limits: Limits) -> Any:
    checkout = pool.checkout(
        limits={
            "max_feed_duration_secs": limits.seconds,
            "max_memory": limits.memory_bytes,
            "max_recursion_depth": limits.recursion,
            "max_suspensions": limits.calls,
        },
        assert_message_annotations=False,
    )
    try:
        with checkout as session:
            session.feed_run(PRELUDE, inputs=_TYPES)
            return session.feed_run(
                f"{lowered.text}\n{RESULT}",
                external_lookup={HOST: host.call},
                print_callback=monty.CollectString(max_bytes=1_000),
            )
    except monty.MontyCrashedError:
        raise ProgramError(
            f"the program was stopped: it exceeds {limits.seconds:g} s or "
            f"{limits.memory_bytes >> 20} MiB; loop over fewer things"
        ) from None
    except monty.MontyError as error:
        if host.failure is not None:
            raise host.failure from None
        raise ProgramError(_explain(error, lowered)) from None
    except TimeoutError:
        raise ProgramError("no sandbox worker became free; run fewer groundings at once") from None


def _explain(error: monty.MontyError, lowered: LoweredProgram) -> str:
    """One line with the place in the program as it was written."""
    frames = error.traceback() if hasattr(error, "traceback") else []
    # The outermost frame is the program's; frames of other files are the prelude's.
    lines = [frame.line for frame in frames if frame.filename == frames[0].filename]
    known = [lowered.lines[line] for line in lines if line in lowered.lines]
    place = f" in line {known[-1]}" if known else ""
    return f"the program fails{place}: {error}"


@dataclass(slots=True)
class _Host:
    """The one function that the sandbox can call, and what it needs to judge the calls."""

    program: CheckedProgram
    api: SceneApi
    limits: Limits
    facade: Facade = field(default_factory=Facade)
    failure: BaseException | None = None
    """What the scene functions raised; it outlives its passage through the sandbox."""
    _array_seconds: float = 0.0
    """Processor time, so that a busy machine stops no honest program."""
    _handles: dict[str, dict[str, Any]] = field(default_factory=dict)

    def call(self, name: Any, *args: Any, **options: Any) -> Any:
        """Serve one call; errors of array work go back into the program as its own."""
        if isinstance(name, str) and name.startswith("self."):
            return self._scene(name.removeprefix("self."), args, options)
        if self._array_seconds > self.limits.seconds:
            raise TimeoutError(f"array work exceeds {self.limits.seconds:g} s")
        began = time.thread_time()
        try:
            return _outward(self.facade.call(name, args, options))
        finally:
            self._array_seconds += time.thread_time() - began

    def instances(self, output: Any) -> list[Instance | None]:
        """Turn the answer into instances: pointers, dicts with one, or None, in a list."""
        if not isinstance(output, (list, tuple)):
            raise ProgramError(
                f"{RESULT}: expected a list of pointers, got {type(output).__name__}"
            )
        return [self._instance(item, f"{RESULT}[{i}]") for i, item in enumerate(output)]

    def _instance(self, item: Any, where: str) -> Instance | None:
        pointer = item.get("pointer") if isinstance(item, dict) else item
        if item is None:
            return None
        if not isinstance(pointer, Pointer) or pointer.instance.id not in self._handles:
            raise ProgramError(
                f'{where}: expected the "pointer" of an object that the program was given, '
                f"or None, got {_kind(item)}"
            )
        return pointer.instance

    def _scene(self, method: str, args: tuple[Any, ...], options: dict[str, Any]) -> Any:
        names = ("instance", "category") if method == "find_instance_in_category" else ("phrase",)
        words = _text_arguments(f"self.{method}", names, args, options)
        if method not in SCENE_METHODS[self.program.kind]:
            raise TypeError(f"self.{method} is not offered")
        try:
            if method == "find_instance_in_category":
                return [int(index) for index in self.api.find_instance_in_category(*words)]
            found = self.api.detect(*words) if method == "detect" else self.api.get_obj(*words)
        except BaseException as error:
            # Ctrl-C too: the sandbox would make an error of the program's of it. Raised outside.
            self.failure = error
            raise RuntimeError(f"self.{method} failed") from None
        return [self._handle(instance) for instance in found]

    def _handle(self, instance: Instance) -> dict[str, Any]:
        """The dict by which programs know an instance; the same one whenever it is found."""
        if instance.id not in self._handles:
            points = self.facade.wrap(instance.points_world.astype("float64"), frozen=True)
            self._handles[instance.id] = {
                "pcd": _opaque(points),
                "pointer": _opaque(Pointer(instance, len(self._handles))),
            }
        return self._handles[instance.id]


def _text_arguments(
    where: str, names: Sequence[str], args: tuple[Any, ...], options: dict[str, Any]
) -> list[str]:
    """Bind positional and keyword arguments that must all be short texts."""
    given = {**dict(zip(names, args, strict=False)), **options}
    # `detect` and `get_obj` take one argument, whatever a program calls it.
    if len(names) == 1 and len(given) == 1:
        given = {names[0]: next(iter(given.values()))}
    if set(given) != set(names) or len(args) + len(options) != len(names):
        raise TypeError(f"{where} takes {len(names)} texts: {', '.join(names)}")
    for name, value in given.items():
        if not isinstance(value, str) or not 0 < len(value) <= MAX_PHRASE:
            raise TypeError(f"{where}: {name} must be a text of 1 to {MAX_PHRASE} characters")
    return [given[name] for name in names]


def _outward(value: Any) -> Any:
    """Wrap every handle of a result so that the sandbox gets no more than its serial number."""
    if isinstance(value, Array):
        return _opaque(value)
    if isinstance(value, (list, tuple)):
        return type(value)(_outward(item) for item in value)
    return value


def _opaque(handle: Array | Pointer) -> monty.ClassInstance:
    # The serial number must go along: Monty compares instances by the attributes they carry.
    return monty.ClassInstance(handle, eager_attrs=("serial",))


def _kind(value: Any) -> str:
    return "an array" if isinstance(value, Array) else f"a value of type {type(value).__name__}"


_TYPES = {"_Array": monty.ClassType(Array), "_Pointer": monty.ClassType(Pointer)}


class _Depth(threading.local):
    """How many programs of this thread wait for the present one."""

    value = 0


_DEPTH = _Depth()


class _Pools:
    """Worker processes by depth, started when first needed and ended with the interpreter."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pools: dict[int, monty.Monty] = {}
        self._pid: int | None = None

    def get(self, depth: int) -> monty.Monty:
        """The pool for programs at `depth`.

        Raises:
            SetupError: This process was forked from one that has used the sandbox.
        """
        # Monty's threads do not survive a fork, and its calls would then wait for ever. So this is
        # judged before the lock, which another thread may have held at that moment.
        if self._pid not in (None, os.getpid()):
            raise SetupError(
                "the sandbox was in use when this process was forked; start worker processes with "
                "multiprocessing.get_context('spawn')"
            )
        with self._lock:
            self._pid = os.getpid()
            if depth not in self._pools:
                pool = monty.Monty(checkout_timeout=10.0, feed_duration_limit_grace=0.3)
                self._pools[depth] = pool.__enter__()
            return self._pools[depth]

    def close(self) -> None:
        """End the workers of this process."""
        if self._pid != os.getpid():
            return
        with self._lock:
            while self._pools:
                self._pools.popitem()[1].__exit__(None, None, None)


_POOLS = _Pools()
atexit.register(_POOLS.close)
