"""What lowered programs call, written in the sandbox's own language and run inside it.

The sandbox's interpreter dispatches only some operators to host objects, so `lowering.py` turns
every operator that an array could meet into a call of these functions. On numbers, text, lists and
dicts they do what the operator does; where an array takes part they ask the host (`facade.py`).
All names begin with an underscore, which programs cannot write.
"""

MAX_TEXT = 1_000
MAX_REPEATS = 10_000

PRELUDE = f"""
def _bounded(value):
    if type(value) is int and (value > 2**63 or value < -2**63):
        raise OverflowError("whole numbers beyond 2**63 are not allowed")
    return value

def _op(name, a, b):
    if isinstance(a, _Array) or isinstance(b, _Array):
        return _host(name, a, b)
    if name == "add":
        if type(a) is str and type(b) is str and len(a) + len(b) > {MAX_TEXT}:
            raise OverflowError("text longer than {MAX_TEXT} characters is not allowed")
        return _bounded(a + b)
    if name == "sub":
        return _bounded(a - b)
    if name == "mul":
        return _times(a, b)
    if name == "truediv":
        return a / b
    if name == "floordiv":
        return _bounded(a // b)
    if name == "mod":
        if type(a) is str:
            raise TypeError("text cannot be formatted; programs answer with objects")
        return a % b
    if name == "pow":
        if type(a) is int and type(b) is int and (b > 64 or b < -64):
            raise OverflowError("powers beyond 64 are not allowed")
        return _bounded(a ** b)
    if name == "and":
        return a & b
    if name == "or":
        return a | b
    return a ^ b

def _times(a, b):
    if type(a) is int and type(b) in (list, tuple, str):
        a, b = b, a
    if type(a) in (list, tuple, str):
        if type(b) is int and len(a) * b > {MAX_REPEATS}:
            raise MemoryError("lists and text longer than {MAX_REPEATS} items are not allowed")
    return _bounded(a * b)

def _iop(name, a, b):
    if isinstance(a, _Array):
        return _host("i" + name, a, b)
    if name == "add" and type(a) is list:
        a.extend(_iter(b))
        return a
    return _op(name, a, b)

def _cmp(name, a, b):
    if isinstance(a, _Array) or isinstance(b, _Array):
        return _host(name, a, b)
    if name == "eq":
        return a == b
    if name == "ne":
        return a != b
    if name == "lt":
        return a < b
    if name == "le":
        return a <= b
    if name == "gt":
        return a > b
    return a >= b

def _in(item, box):
    if isinstance(box, _Array):
        return _host("contains", box, item)
    return item in box

def _chain(first, *rest):
    left = first
    result = True
    for compare, operand in rest:
        right = operand()
        result = compare(left, right)
        if not _truth(result):
            return result
        left = right
    return result

def _neg(x):
    return _host("neg", x) if isinstance(x, _Array) else -x

def _invert(x):
    return _host("invert", x) if isinstance(x, _Array) else ~x

def _truth(x):
    return _host("truth", x) if isinstance(x, _Array) else x

def _and(*parts):
    for part in parts:
        value = part()
        if not _truth(value):
            return value
    return value

def _or(*parts):
    for part in parts:
        value = part()
        if _truth(value):
            return value
    return value

def _get(x, key):
    if isinstance(x, _Array):
        return _host("get", x, key)
    if isinstance(key, _Array):
        raise TypeError("a list takes whole numbers in [ ]; make it an array first: np.array(...)")
    return x[key]

def _slice(x, start, stop, step):
    if isinstance(x, _Array):
        return _host("get", x, ("slice", start, stop, step))
    return x[start:stop:step]

def _set(x, key, value):
    if isinstance(x, _Array):
        _host("set", x, key, value)
    else:
        x[key] = value

def _attr(x, name):
    if isinstance(x, _Array):
        return _host("attr", x, name)
    raise AttributeError("." + name + " is for arrays; make it one first: np.array(...)")

def _method(x, name, *args, **options):
    if isinstance(x, _Array):
        return _host("method", name, x, *args, **options)
    if name == "copy":
        return x.copy()
    if name == "item" or name == "tolist":
        return x
    raise AttributeError("." + name + "(...) is for arrays; use np." + name + "(...)")

def _iter(x):
    return _host("rows", x) if isinstance(x, _Array) else x

def _unpack(value, pattern):
    if pattern is None:
        return value
    items = list(_iter(value))
    if len(items) != len(pattern):
        raise ValueError(
            "cannot unpack: " + str(len(pattern)) + " names for " + str(len(items)) + " values"
        )
    return [_unpack(items[i], pattern[i]) for i in range(len(items))]

def _len(x):
    return _host("len", x) if isinstance(x, _Array) else len(x)

def _abs(x):
    return _host("np.abs", x) if isinstance(x, _Array) else abs(x)

def _round(x, *digits):
    return _host("np.round", x, *digits) if isinstance(x, _Array) else round(x, *digits)

def _int(x=0):
    return int(_host("method", "item", x) if isinstance(x, _Array) else x)

def _float(x=0.0):
    return float(_host("method", "item", x) if isinstance(x, _Array) else x)

def _bool(x=False):
    return bool(_truth(x))

def _min(*args, **options):
    return min(*[_iter(a) for a in args], **options)

def _max(*args, **options):
    return max(*[_iter(a) for a in args], **options)

def _sum(items, start=0):
    total = start
    for item in _iter(items):
        total = _op("add", total, item)
    return total

def _any(items):
    for item in _iter(items):
        if _truth(item):
            return True
    return False

def _all(items):
    for item in _iter(items):
        if not _truth(item):
            return False
    return True

def _next(items, *default):
    if len(items) > 0:
        return items[0]
    if len(default) > 0:
        return default[0]
    raise ValueError("next(...): nothing is left; give a second argument for that case")
"""
