"""What a xacro has given names to: properties, blocks, macros and namespaces, in scopes inside each other."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any
from xml.etree.ElementTree import Element

from cei_gym.embodiment.xacro.functions import Value
from cei_gym.errors import CEIError, one_line

_MOST_PARAMETERS = 200
_PARAMETER = re.compile(
    r"""\s*+(?P<name>[^\s:=]++)"""
    r"""(?:\s*+:?=\s*+(?P<forward>\^\|?)?(?P<default>(?:\$\{[^}]*\}|\$\([^)]*\)|'[^']*'|"[^"]*"|[^\s'"])*+)(?=\s|\Z))?+"""
)


@dataclass(frozen=True)
class Macro:
    """A macro.

    Attributes:
        body: its element; what is in it is what it stands for.
        parameters: names, `*name` of an element, `**name` of what is in one.
        defaults: of some of them: whether the caller's property of that name is taken (`^`), and the text for otherwise.
    """

    body: Element
    parameters: list[str]
    defaults: dict[str, tuple[bool, str | None]]


@dataclass
class Scope:
    """Names of a file or of a macro's body, and those of who called it.

    Attributes:
        evaluate: what a text stands for in a scope; a property is evaluated when it is first asked for, in the scope that has it.
        parent: where names are looked for that this one lacks.
        is_namespace: whether an include made it, under a name of its own.
        blocks: `*name` or `**name` to elements.
        macros: by name.
        spaces: namespaces by name.
    """

    evaluate: Callable[[str, "Scope"], Value]
    parent: "Scope | None" = None
    is_namespace: bool = False
    blocks: dict[str, Element] = field(default_factory=dict[str, Element])
    macros: dict[str, Macro] = field(default_factory=dict[str, Macro])
    spaces: dict[str, "Scope"] = field(default_factory=dict[str, Any])
    _values: dict[str, Value] = field(default_factory=dict[str, Any])
    _texts: dict[str, str] = field(default_factory=dict[str, str])
    _asked: list[str] = field(default_factory=list[str])

    def chain(self) -> Iterator["Scope"]:
        """This scope and those around it, the innermost first."""
        scope: Scope | None = self
        while scope is not None:
            yield scope
            scope = scope.parent

    def __contains__(self, name: str) -> bool:
        return any(name in scope._values or name in scope._texts or name in scope.spaces for scope in self.chain())

    def __getitem__(self, name: str) -> Value:
        for scope in self.chain():
            if name in scope._texts:
                scope._resolve(name)
            if name in scope._values:
                return scope._values[name]
            if name in scope.spaces:
                return scope.spaces[name]
        raise CEIError(f"{one_line(name, 60)!r} is not defined")

    def set(self, name: str, value: Value, lazy: bool = False) -> None:
        """Give a name to a value; to what a text stands for, if it is `lazy`."""
        value = literal(value)
        self._values.pop(name, None)
        self._texts.pop(name, None)
        if lazy and isinstance(value, str):
            self._texts[name] = value
        else:
            self._values[name] = value

    def remove(self, name: str) -> None:
        """Forget a property, everywhere."""
        for scope in self.chain():
            scope._values.pop(name, None)
            scope._texts.pop(name, None)

    def block(self, name: str) -> tuple[Element, bool] | None:
        """A block, and whether what is in it is meant, not it itself."""
        for key, content_only in ((f"**{name}", True), (f"*{name}", False)):
            for scope in self.chain():
                if key in scope.blocks:
                    return scope.blocks[key], content_only
        return None

    def macro(self, name: str) -> "tuple[Macro, Scope] | None":
        """A macro, and the scope in which it is called: this one, or the namespace that the name has before a dot."""
        for scope in self.chain():
            if name in scope.macros:
                return scope.macros[name], self
        space, dot, rest = name.partition(".")
        if dot:
            found = next((scope.spaces[space] for scope in self.chain() if space in scope.spaces), None)
            return None if found is None else found.macro(rest)
        return None

    def _resolve(self, name: str) -> None:
        if name in self._asked:
            circle = " -> ".join([*self._asked[self._asked.index(name) :], name])
            raise CEIError(f"properties depend on each other in a circle: {one_line(circle)}")
        self._asked.append(name)
        value = literal(self.evaluate(self._texts[name], self))
        self._asked.pop()
        self._texts.pop(name, None)
        self._values[name] = value


def literal(value: Value) -> Value:
    """The number, truth or text that a text is, as xacro has it; other values as they are."""
    if not isinstance(value, str):
        return value
    if len(value) >= 2 and value[0] == value[-1] == "'":
        return value[1:-1]
    if "_" in value:  # in numbers Python would read over it
        return value
    for read in (int, float):
        try:
            return read(value)
        except ValueError:
            pass
    return {"true": True, "True": True, "false": False, "False": False}.get(value, value)


def truth(value: Value, text: str) -> bool:
    """Whether a condition holds.

    Raises:
        CEIError: it is neither true nor false.
    """
    if not isinstance(value, str):
        return bool(value)
    if value in ("true", "True", "false", "False"):
        return value in ("true", "True")
    try:
        return bool(int(value))
    except ValueError:
        raise CEIError(f"{one_line(text, 80)!r} is {one_line(value, 60)!r}, neither true nor false") from None


def parameters(text: str) -> tuple[list[str], dict[str, tuple[bool, str | None]]]:
    """Names and defaults of a macro's parameters, as in `prefix *origin mass:=1 parent:=^|world`; see `Macro`.

    Raises:
        CEIError: it is no list of parameters, or a long one.
    """
    names: list[str] = []
    defaults: dict[str, tuple[bool, str | None]] = {}
    text, at = text.strip(), 0
    while at < len(text):
        if len(names) == _MOST_PARAMETERS:
            raise CEIError(f"a macro has more than {_MOST_PARAMETERS} parameters")
        if (part := _PARAMETER.match(text, at)) is None:
            raise CEIError(f"{one_line(text[at:], 60)!r} is no parameter of a macro")
        at = part.end()
        names.append(part["name"])
        if part["default"] is not None:
            defaults[part["name"]] = (part["forward"] is not None, part["default"] or None)
    return names, defaults
