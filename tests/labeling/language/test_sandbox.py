from __future__ import annotations

import os
import threading
import time

import pytest

from codediffuser.errors import InstructionError, ProgramError
from codediffuser.labeling.language.checker import check_program
from codediffuser.labeling.language.sandbox import Limits, SceneApi, run_program


@pytest.fixture
def api(make_scene) -> SceneApi:
    scene = make_scene({"a": (0.0, 0.0), "b": (0.05, 0.0)}, taken=[0])
    return SceneApi(scene.instances, scene.instances, scene.find_instance_in_category)


def run(text: str, api: SceneApi, **limits: float) -> list[str | None]:
    found = run_program(check_program(text), api, Limits(**limits) if limits else None)
    return [item and item.id for item in found]


ESCAPES = {
    # What never parses into the language.
    "import": "import os\noutput_var = [os.listdir('/')]",
    "dunder import": "output_var = [__import__('os')]",
    "import by text": "f = '__imp' + 'ort__'\noutput_var = [f('os')]",
    "class walk": "output_var = [().__class__.__base__.__subclasses__()]",
    "mro of a handle": "output_var = [self.detect('battery')[0]['pcd'].__class__.mro()]",
    "handle fields": "output_var = [self.detect('battery')[0]['pcd'].values]",
    "handle serial": "output_var = [self.detect('battery')[0]['pointer'].serial]",
    "instance": "output_var = [self.detect('battery')[0]['pointer'].instance]",
    "bound function": "output_var = [self.detect.__globals__]",
    "np internals": "output_var = [np.core.multiarray]",
    "np files": "output_var = [np.loadtxt('/etc/passwd')]",
    "np pickle": "output_var = [np.load('x', allow_pickle=True)]",
    "array to file": "np.array([1]).tofile('/tmp/escaped')\noutput_var = [1]",
    "array buffer": "output_var = [np.array([1]).ctypes]",
    "format": "output_var = ['{0.__class__}'.format(self.detect)]",
    "format of a constant": "output_var = ['{0.__class__.__init__.__globals__}'.format(1)]",
    "format map": "output_var = ['{a}'.format_map({'a': 1})]",
    "percent": "output_var = ['%s' % self.detect('battery')[0]['pointer']]",
    "f-string": "output_var = [f'{self.detect.__name__}']",
    "getattr": "output_var = [getattr(self, 'det' + 'ect')]",
    "setattr": "setattr(self, 'x', 1)\noutput_var = [1]",
    "vars": "output_var = [vars()]",
    "exec": "exec('import os')\noutput_var = [1]",
    "eval": "output_var = [eval('1')]",
    "compile": "output_var = [compile('1', '', 'eval')]",
    "open": "output_var = [open('/etc/passwd').read()]",
    "type": "output_var = [type('X', (), {})]",
    "class": "class X:\n    pass\noutput_var = [X()]",
    "decorator": "@self.detect\ndef f(x):\n    return x\noutput_var = [1]",
    "generator frame": "g = (x for x in [1])\noutput_var = [g.gi_frame.f_back]",
    "traceback": "try:\n    1 / 0\nexcept Exception as e:\n    output_var = [e.__traceback__]",
    "comprehension scope": "x = [self for self in [1]]\noutput_var = x",
    "comprehension shadows": "y = [_host for _host in [1]]\noutput_var = y",
    "prelude function": "output_var = [_host('np.load', 'x')]",
    "lambda default": "f = lambda x=__builtins__: x\noutput_var = [f()]",
    "global": "def f():\n    global output_var\n    output_var = [1]\nf()",
    "star arguments": "output_var = [max(*[[1]])]",
    "while": "while True:\n    pass\noutput_var = [1]",
    # What runs into a limit.
    "endless loop": "l = [1]\nfor x in l:\n    l.append(x)\noutput_var = l",
    "long loop": "n = 0\nfor i in range(10 ** 12):\n    n += 1\noutput_var = [n]",
    "nested loops": (
        "n = 0\nfor i in range(10000):\n    for j in range(10000):\n        n = i\noutput_var = [n]"
    ),
    "loop of host calls": (
        "n = 0\nfor i in range(10 ** 9):\n    n = np.abs(np.array([1]))\noutput_var = [n]"
    ),
    "recursion": "def f(n):\n    return f(n + 1)\noutput_var = [f(0)]",
    "recursion of lambdas": "f = lambda g: g(g)\noutput_var = [f(f)]",
    "tower of powers": "output_var = [10 ** 10 ** 10]",
    "huge power": "output_var = [2 ** (2 ** 40)]",
    "growing number": "x = 9\nfor i in range(99):\n    x = x * x\noutput_var = [x]",
    "growing number in place": "x = 9\nfor i in range(99):\n    x *= x\noutput_var = [x]",
    "long text": "x = 'a' * 10 ** 10\noutput_var = [x]",
    "doubling text": "x = 'a'\nfor i in range(99):\n    x = x + x\noutput_var = [x]",
    "long list": "x = [0] * 10 ** 10\noutput_var = x",
    "doubling list": "x = [0]\nfor i in range(99):\n    x = x + x\noutput_var = x",
    "list of a range": "output_var = list(range(10 ** 12))",
    "sum of a range": "output_var = [sum(range(10 ** 12))]",
    "comprehension": "output_var = [[i, j] for i in range(10000) for j in range(10000)]",
    "dict": "output_var = [{i: [0] * 999 for i in range(10 ** 6)}]",
    "huge array": "output_var = [np.zeros((10 ** 5, 10 ** 5))]",
    "many arrays": "output_var = [[np.zeros(10 ** 6) for i in range(1000)]]",
    "heavy array work": (
        "x = np.zeros((1000, 1000))\nfor i in range(10 ** 6):\n    y = np.sort(x)\noutput_var = [y]"
    ),
    "outer product": "x = np.arange(10 ** 5)\noutput_var = [x[:, None] * x[None]]",
    "deep nesting": "x = []\nfor i in range(10 ** 5):\n    x = [x]\noutput_var = [x]",
    "cycle": "x = []\nx.append(x)\noutput_var = x",
    "print": "print('a' * 999)\noutput_var = [1]",
    # What answers with something else.
    "number": "output_var = [1]",
    "text": "output_var = ['battery_0']",
    "no list": "output_var = 3",
    "array": "output_var = np.array([1, 2])",
    "points": "output_var = [self.detect('battery')[0]['pcd']]",
    "made-up object": "output_var = [{'pcd': 1, 'pointer': 2}]",
    "function": "output_var = [lambda x: x]",
    "wrong arguments": "output_var = self.detect('battery', 'slot')",
    "number for text": "output_var = self.detect(3)",
    "long phrase": "output_var = self.detect('a' * 5000)",
    "wrong category": "output_var = [self.get_obj('engine')]",
}


@pytest.mark.parametrize("name", ESCAPES)
def test_escapes_end_as_one_program_error_at_once(name: str, make_scene) -> None:
    scene = make_scene()

    def instances(category: str) -> object:
        if category not in scene.categories:
            raise ProgramError(f"Unknown category '{category}'")
        return scene.instances(category)

    api = SceneApi(instances, instances, scene.find_instance_in_category)  # type: ignore[arg-type]
    began = time.perf_counter()
    with pytest.raises(ProgramError) as caught:
        run(ESCAPES[name], api)
    assert time.perf_counter() - began < 4.0  # 2 s alone; more while other tests share the cores.
    assert "\n" not in str(caught.value)


def test_answers_may_be_pointers_objects_or_none(api: SceneApi) -> None:
    text = "b = self.get_obj('battery')\noutput_var = (b[0]['pointer'], b[1], None)"
    assert run(text, api) == ["a", "b", None]


def test_an_object_equals_itself_and_no_other_however_it_was_found(api: SceneApi) -> None:
    text = (
        "one = self.detect('battery')[1]\nall = self.get_obj('battery')\n"
        "output_var = [o for o in all if o != one] + [o for o in all if o in [one]]"
    ).replace("all", "things")
    assert run(text, api) == ["a", "packed_0", "b"]


def test_keyword_arguments_of_scene_functions(api: SceneApi) -> None:
    text = (
        "i = self.find_instance_in_category(instance='green battery', category='battery')\n"
        "output_var = [self.get_obj(category='battery')[k] for k in i]"
    )
    assert run(text, api) == ["a", "b", "packed_0"]


def test_errors_of_the_scene_come_out_unchanged(api: SceneApi) -> None:
    def fails(phrase: str) -> list[object]:
        raise InstructionError("nothing like that")

    broken = SceneApi(fails, api.get_obj, api.find_instance_in_category)  # type: ignore[arg-type]
    with pytest.raises(InstructionError, match="nothing like that"):
        run("output_var = self.detect('x')", broken)


def test_a_program_may_run_inside_a_call_of_another(api: SceneApi) -> None:
    inner = check_program("output_var = self.get_obj('battery')[1:2]", "detect")
    outer = SceneApi(
        lambda phrase: [i for i in run_program(inner, api) if i is not None],
        api.get_obj,
        api.find_instance_in_category,
    )
    assert run("output_var = self.detect('x') + self.detect('y')", outer) == ["b", "b"]


def test_the_time_limit_leaves_out_what_scene_functions_take(api: SceneApi) -> None:
    def slow(phrase: str) -> object:
        time.sleep(0.4)
        return api.get_obj("battery")

    patient = SceneApi(slow, api.get_obj, api.find_instance_in_category)  # type: ignore[arg-type]
    assert run("output_var = self.detect('x')[:1]", patient, seconds=0.2) == ["a"]


def test_programs_leave_nothing_behind_for_the_next(api: SceneApi) -> None:
    run("secret = self.get_obj('battery')\noutput_var = secret", api)
    with pytest.raises(ProgramError, match="secret"):
        run("if False:\n    secret = 1\noutput_var = secret", api)


def test_threads_run_programs_side_by_side(api: SceneApi) -> None:
    results: list[list[str | None]] = []

    def work() -> None:
        results.append(run("output_var = self.get_obj('battery')[:1]", api))

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [["a"]] * 4


def _fork_and_run() -> str:
    """Run one program in a child that is forked from this process; what came of it."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            api = SceneApi(lambda p: [], lambda c: [], lambda p, c: [])
            run_program(check_program("output_var = []"), api)
            os.write(writing, b"ran")
        except BaseException as error:
            os.write(writing, f"{type(error).__name__}: {error}".encode())
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as stream:
        told = stream.read()
    os.waitpid(child, 0)
    return told


def test_a_forked_process_is_told_to_spawn_instead_of_hanging(api: SceneApi) -> None:
    run("output_var = self.get_obj('battery')[:1]", api)
    assert "SetupError" in (told := _fork_and_run()) and "spawn" in told
    assert run("output_var = self.get_obj('battery')[:1]", api) == ["a"]
