"""The expressions of a xacro, by a whitelist of Python's syntax and functions, bounded in size and work; nothing is run by Python's `eval`."""

import ast
import operator
import warnings
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Protocol

from cei_gym.embodiment.xacro.functions import CONSTANTS, FUNCTIONS, MAX_SIZE, METHODS, Fault, Value, size
from cei_gym.errors import CEIError, one_line

_MAX_WORK, _MAX_BITS, _MAX_EXPRESSION = 3_000_000, 1024, 10_000
_SHOWN = 80


class Names(Protocol):
    """What an expression may name."""

    def __contains__(self, name: str, /) -> bool: ...

    def __getitem__(self, name: str, /) -> Value: ...


class Evaluator:
    """Evaluates the expressions of one file and what it includes; all of them together may take so much work.

    Args:
        functions: those that need more than their arguments, by dotted name.
    """

    def __init__(self, functions: Mapping[str, Callable[..., Value]]) -> None:
        self._functions = {**FUNCTIONS, **functions}
        self._work = 0

    def value(self, expression: str, names: Names) -> Value:
        """Evaluate one expression.

        Raises:
            CEIError: it is not allowed, or has no value; the message names it.
        """
        try:
            return self._value(_parsed(expression.strip()), names)
        except Fault as fault:
            reason = str(fault)
        except CEIError:  # of another expression, on which this one depends
            raise
        except (RecursionError, MemoryError):
            reason = "it is nested too deeply, or too large"
        except KeyError as error:
            reason = f"there is no {one_line(error, 60)}"
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            reason = one_line(error, 100)
        shown = " ".join(expression.split())
        raise CEIError(f"${{{shown if len(shown) <= _SHOWN else f'{shown[:_SHOWN]} ...'}}}: {reason}")

    def spend(self, work: int) -> None:
        """Count work: about one for each operation, and for each letter or entry that one looks at.

        Raises:
            Fault: it is too much.
        """
        self._work += work
        if self._work > _MAX_WORK:
            raise Fault("all expressions together take too much work")

    def _value(self, node: ast.expr, names: Names) -> Value:
        value = self._any(node, names)
        if _is_namespace(value):
            raise Fault("a namespace is no value")
        return value

    def _any(self, node: ast.expr, names: Names) -> Value:
        """A value, or a namespace."""
        self.spend(1)
        match node:
            case ast.Constant(value=bool() | int() | float() | str() | None as value):
                return _bounded(value)
            case ast.Name(id=name):
                if name in names:
                    return names[name]
                if name in CONSTANTS:
                    return CONSTANTS[name]
                raise Fault(f"{one_line(name, 60)!r} is not defined")
            case ast.List(elts=parts) | ast.Tuple(elts=parts):
                return self._made([self._value(part, names) for part in parts])
            case ast.Dict(keys=keys, values=values):
                if None in keys:
                    raise Fault("** is not allowed")
                pairs = zip([key for key in keys if key is not None], values, strict=True)
                return self._made({self._value(key, names): self._value(value, names) for key, value in pairs})
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _UNARY:
                value = self._value(operand, names)
                if not isinstance(op, ast.Not):
                    _numbers(value)
                return _UNARY[type(op)](value)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
                return self._binary(op, self._value(left, names), self._value(right, names))
            case ast.BoolOp(op=op, values=parts):
                value = None
                for part in parts:
                    value = self._value(part, names)
                    if bool(value) is isinstance(op, ast.Or):
                        break
                return value
            case ast.Compare(left=left, ops=ops, comparators=parts):
                return self._comparison(left, ops, parts, names)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return self._value(body if self._value(test, names) else orelse, names)
            case ast.Subscript(value=of, slice=at):
                return self._part(self._value(of, names), at, names)
            case ast.Attribute():
                return self._attribute(node, names)
            case ast.Call():
                return self._called(node, names)
            case _:
                raise Fault(f"Python's {type(node).__name__} is not allowed")

    def _made(self, value: Value) -> Value:
        """A value that is new, counted and bounded."""
        self.spend(size(value))
        return _bounded(value)

    def _binary(self, op: ast.operator, a: Value, b: Value) -> Value:
        if isinstance(op, ast.Add) and type(a) is type(b) and isinstance(a, (str, list)):
            return self._made(a + b)
        _numbers(a, b)
        if isinstance(op, ast.Pow) and isinstance(a, int) and isinstance(b, int) and a.bit_length() * b > _MAX_BITS:
            raise Fault("the number is too large")
        return _bounded(_BINARY[type(op)](a, b))

    def _comparison(self, left: ast.expr, ops: list[ast.cmpop], parts: list[ast.expr], names: Names) -> bool:
        a = self._value(left, names)
        for op, part in zip(ops, parts, strict=True):
            b = self._value(part, names)
            self.spend(size(a) + size(b))
            if not _COMPARED[type(op)](a, b):
                return False
            a = b
        return True

    def _part(self, of: Value, at: ast.expr, names: Names) -> Value:
        if type(of) not in (str, list, dict):
            raise Fault(f"{_kind(of)} has no parts")
        if not isinstance(at, ast.Slice):
            return of[self._value(at, names)]
        ends = [None if end is None else self._value(end, names) for end in (at.lower, at.upper, at.step)]
        if type(of) is dict:
            raise Fault("a dict has no slices")
        return self._made(of[slice(*ends)])

    def _attribute(self, node: ast.Attribute, names: Names) -> Value:
        """Entry of a dict, or of a namespace, written with a dot."""
        if isinstance(node.value, ast.Name) and node.value.id in _MODULES and node.value.id not in names:
            if node.attr not in CONSTANTS:
                raise Fault(f"{node.value.id}.{one_line(node.attr, 60)} is no number")
            return CONSTANTS[node.attr]
        of = self._any(node.value, names)
        if _has_entries(of):
            if node.attr in of:
                return of[node.attr]
            raise Fault(f"there is no {one_line(node.attr, 60)!r}")
        raise Fault(f"{_kind(of)} has no attribute {one_line(node.attr, 60)!r}")

    def _called(self, node: ast.Call, names: Names) -> Value:
        function = self._function(node.func, names)
        arguments = [self._value(argument, names) for argument in node.args]
        if any(keyword.arg is None for keyword in node.keywords):
            raise Fault("** is not allowed")
        if node.keywords and function is not dict:
            raise Fault("only dict() takes arguments by name")
        named = {str(keyword.arg): self._value(keyword.value, names) for keyword in node.keywords}
        self.spend(sum(map(size, arguments)))
        return self._made(function(*arguments, **named))

    def _function(self, node: ast.expr, names: Names) -> Callable[..., Value]:
        match node:
            case ast.Name(id=name) if name not in names and name in self._functions:
                return self._functions[name]
            case ast.Attribute(value=ast.Name(id=module), attr=name) if module in _MODULES and module not in names:
                key = f"xacro.{name}" if module == "xacro" else name
                if key not in self._functions:
                    raise Fault(f"{module}.{one_line(name, 60)}() is not allowed")
                return self._functions[key]
            case ast.Attribute(value=of, attr=name):
                owner = self._value(of, names)
                method = METHODS.get((owner.__class__, name))
                if method is None:
                    raise Fault(f"{_kind(owner)} has no .{one_line(name, 60)}() here")
                return lambda *arguments: method(owner, *arguments)
            case ast.Name(id=name):
                raise Fault(f"{one_line(name, 60)}() is not allowed")
            case _:
                raise Fault("only functions can be called")


@lru_cache(maxsize=1024)
def _parsed(expression: str) -> ast.expr:
    if len(expression) > _MAX_EXPRESSION:
        raise Fault(f"it has more than {_MAX_EXPRESSION} letters")
    try:
        with warnings.catch_warnings(action="ignore"):
            return ast.parse(expression, mode="eval").body
    except SyntaxError as error:
        raise Fault(one_line(error.msg, 100)) from None


def _bounded(value: Value) -> Value:
    if isinstance(value, int):
        if value.bit_length() > _MAX_BITS:
            raise Fault("the number is too large")
    elif type(value) not in (float, str, list, dict, type(None)):
        raise Fault(f"its value would be {_kind(value)}")
    elif size(value) > MAX_SIZE:
        raise Fault("its value is too large")
    return value


def _numbers(*values: Value) -> None:
    for value in values:
        if not isinstance(value, (int, float)):
            raise Fault(f"{_kind(value)} is no number")


def _kind(value: Value) -> str:
    return "a namespace" if _is_namespace(value) else f"a {type(value).__name__}"


def _has_entries(value: Value) -> bool:
    return type(value) is dict or _is_namespace(value)


def _is_namespace(value: Value) -> bool:
    """Whether it is what an `<xacro:include ns=...>` has brought."""
    return type(value) not in (str, list, dict) and hasattr(value, "__getitem__")


_MODULES = ("math", "python", "xacro")
_UNARY: dict[type[ast.unaryop], Callable[[Value], Value]] = {
    ast.Not: operator.not_,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_BINARY: dict[type[ast.operator], Callable[[Value, Value], Value]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.FloorDiv: lambda a, b: a // b,
    ast.Mod: lambda a, b: a % b,
    ast.Pow: lambda a, b: a**b,
}
_COMPARED: dict[type[ast.cmpop], Callable[[Value, Value], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
}
