"""Functions, constants and methods that a xacro's expressions may use; none takes time or memory beyond its arguments' size."""

import math
import re
from collections.abc import Callable
from typing import Any

from cei_gym.errors import CEIError

MAX_SIZE = 100_000
"""Letters and entries of one value."""

Value = Any
"""None, bool, int, float, str, or a list or dict of such."""


class Fault(CEIError):
    """What is wrong with an expression, without the expression."""


def size(value: Value) -> int:
    """Letters and entries of a value, counted until they are too many."""
    count, rest = 0, [value]
    while rest and count <= MAX_SIZE:
        each = rest.pop()
        count += 1
        if isinstance(each, str):
            count += len(each)
        elif isinstance(each, list):
            rest += each
        elif isinstance(each, dict):
            rest += each.keys()
            rest += each.values()
    return count


def _values(of: dict[Value, Value]) -> list[Value]:
    return list(of.values())


def _get(of: dict[Value, Value], key: Value, default: Value = None) -> Value:
    return of.get(key, default)


def _range(*arguments: int) -> list[int]:
    numbers = range(*arguments)
    if numbers and len(numbers[:MAX_SIZE]) == MAX_SIZE:
        raise Fault("its value is too large")
    return list(numbers)


def _round(value: float, digits: int | None = None) -> float:
    if digits is not None and abs(digits) > 20:
        raise Fault("round() takes at most 20 digits")
    return round(value, digits)


def _replace(text: str, old: str, new: str) -> str:
    if (len(text) + 1) * (len(new) + 1) > MAX_SIZE:
        raise Fault("its value is too large")
    return text.replace(old, new)


def _tokenize(text: str, separators: str = ",; ", skip_empty: bool = True) -> list[str]:
    if not separators:
        raise Fault("tokenize() needs separators")
    return [part for part in re.split(f"[{re.escape(separators)}]", text) if part or not skip_empty]


def _sum(values: list[float]) -> float:
    return sum(values)


def _sorted(values: list[Value]) -> list[Value]:
    return sorted(values)


CONSTANTS: dict[str, Value] = {
    **{name: getattr(math, name) for name in ("pi", "e", "tau", "inf", "nan")},
    "True": True,
    "False": False,
}
FUNCTIONS: dict[str, Callable[..., Value]] = {
    **{
        name: getattr(math, name)
        for name in (
            *("acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "ceil", "copysign", "cos", "cosh", "degrees"),
            *(
                "exp",
                "fabs",
                "floor",
                "fmod",
                "hypot",
                "isclose",
                "isfinite",
                "isinf",
                "isnan",
                "log",
                "log10",
                "log1p",
            ),
            *("log2", "pow", "radians", "sin", "sinh", "sqrt", "tan", "tanh", "trunc"),
        )
    },
    **{each.__name__: each for each in (abs, all, any, bool, dict, float, int, len, list, max, min, str)},
    "range": _range,
    "round": _round,
    "sorted": _sorted,
    "sum": _sum,
    "xacro.tokenize": _tokenize,
    "xacro.dotify": dict,
    "dotify": dict,
}
METHODS: dict[tuple[type, str], Callable[..., Value]] = {
    **{(str, name): getattr(str, name) for name in ("endswith", "lower", "split", "startswith", "strip", "upper")},
    (str, "replace"): _replace,
    (dict, "get"): _get,
    (dict, "keys"): list,
    (dict, "values"): _values,
}
