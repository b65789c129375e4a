"""A xacro's elements, expanded: macros, blocks, conditions, includes; bounded in depth, number and size."""

import re
from collections.abc import Callable, Mapping
from keyword import iskeyword
from xml.etree.ElementTree import Element, SubElement

from cei_gym.embodiment.resources import Place
from cei_gym.embodiment.xacro.expressions import MAX_SIZE, Evaluator, Fault, Value
from cei_gym.embodiment.xacro.files import Files
from cei_gym.embodiment.xacro.scope import Macro, Scope, literal, truth
from cei_gym.errors import CEIError, one_line, unknown
from cei_gym.untrusted_xml import MAX_BYTES, MAX_ELEMENTS

_PREFIX = "xacro:"
_DEEPEST, _MOST_PARAMETERS = 100, 200
_UNREAD = ("gazebo", "ros2_control", "transmission")  # of a <robot>: not read of a URDF, so they need not be expanded

_PARTS = re.compile(r"\$\$+[{(]|\$\{[^}]*\}|\$\([^)]*\)|[^$]+|\$(?![{($])[^$]*")
_PARAMETER = re.compile(
    r"""\s*+(?P<name>[^\s:=]++)"""
    r"""(?:\s*+:?=\s*+(?P<forward>\^\|?)?(?P<default>(?:\$\{[^}]*\}|\$\([^)]*\)|'[^']*'|"[^"]*"|[^\s'"])*+)(?=\s|\Z))?+"""
)


def is_xacro(tree: Element) -> bool:
    """Whether a description has what only xacro gives a meaning to."""
    tags = ("link", "joint", "mesh", "origin", "limit", "mass", "box", "cylinder", "sphere", "axis")
    return any(
        element.tag.startswith(_PREFIX)
        or (element.tag in tags and any("${" in value or "$(" in value for value in element.attrib.values()))
        for element in tree.iter()
    )


def expand(tree: Element, place: Place, arguments: Mapping[str, object]) -> tuple[Element, list[str]]:
    """What a xacro stands for.

    Texts between elements are left out: nothing of a robot is in them.

    Args:
        tree: its root element; not changed.
        place: where it is, and what it may read. `$(find NAME)` is `package://NAME`, so that no folder's name is part of the result.
        arguments: of its `<xacro:arg>`; `place.xacro_args` where they lack one.

    Returns:
        The root element, and sentences about what was assumed.

    Raises:
        CEIError: it cannot be expanded, has what is not allowed, an argument is missing or unknown, or it is too large.
    """
    expander = _Expander(place, {name: _argument(value) for name, value in (place.xacro_args | {**arguments}).items()})
    try:
        expanded = expander.expanded(tree)
        expander.check_arguments(arguments)
    except RecursionError:
        raise CEIError(f"{expander.where}its macros, includes or properties are nested too deeply") from None
    except CEIError as error:
        raise CEIError(f"{expander.where}{error}") from None
    return expanded, expander.notes


class _Expander:
    """One expansion: what was read, counted and given so far."""

    def __init__(self, place: Place, arguments: dict[str, str]) -> None:
        self.notes: list[str] = []
        self._arguments, self._asked = arguments, set[str]()
        self._files = Files(place)
        self._macros: list[str] = []
        self._depth = self._elements = self._letters = 0
        self._evaluator = Evaluator(
            {
                "load_yaml": self._load_yaml,
                "xacro.load_yaml": self._load_yaml,
                "xacro.arg": self._argument,
                "xacro.fatal": self._fatal,
                **{f"xacro.{kind}": self._said for kind in ("error", "warning")},
                **{f"xacro.{kind}": lambda *_: "" for kind in ("message", "print_location")},
            }
        )

    @property
    def where(self) -> str:
        """The included file and the macro that are being expanded, to be put before a message."""
        parts = [name for name in [self._files.included] if name]
        if self._macros:
            parts.append(f"macro {self._macros[-1]!r}")
        return f"{', '.join(parts)}: " if parts else ""

    def expanded(self, tree: Element) -> Element:
        made, scope = Element(tree.tag), Scope(self._text)
        self._expand_children(tree, made, scope)
        self._set_attributes(tree, made, scope)  # last: the arguments that they name are declared inside
        return made

    def check_arguments(self, given: Mapping[str, object]) -> None:
        """Refuse arguments that nothing asked for."""
        for name in given:
            if name not in self._asked:
                raise unknown("name in `xacro_args`", name, sorted(self._asked))

    # -- elements ------------------------------------------------------------------------------------------------------

    def _expand_children(self, source: Element, into: Element, scope: Scope) -> None:
        for child in source:
            self._elements += 1
            if self._elements > MAX_ELEMENTS:
                raise CEIError(f"expanded it has more than {MAX_ELEMENTS} elements")
            if not (into.tag == "robot" and child.tag in _UNREAD):
                self._expand(child, into, scope)

    def _expand(self, element: Element, into: Element, scope: Scope) -> None:
        """Append to `into` what an element stands for."""
        self._depth += 1
        if self._depth > _DEEPEST:
            raise CEIError(f"it is nested more than {_DEEPEST} deep; does a macro, a block or an include use itself?")
        match element.tag:
            case "xacro:property":
                self._property(element, scope)
            case "xacro:macro":
                self._define(element, scope)
            case "xacro:arg":
                self._declare(element, scope)
            case "xacro:include":
                self._include(element, into, scope)
            case "xacro:if" | "xacro:unless":
                text = _required(element, "value")
                if truth(self._text(text, scope), text) is (element.tag == "xacro:if"):
                    self._expand_children(element, into, scope)
            case "xacro:insert_block":
                self._insert(element, into, scope)
            case "xacro:attribute":
                self._set(into, str(self._text(_required(element, "name"), scope)), _required(element, "value"), scope)
            case "xacro:element":
                tag = str(self._text(_required(element, "xacro:name"), scope))
                made = Element(tag, {name: text for name, text in element.items() if name != "xacro:name"})
                made[:] = list(element)
                self._expand(made, into, scope)
            case "xacro:call":
                self._call(str(self._text(_required(element, "macro"), scope)), element, into, scope, ("macro",))
            case tag if tag.startswith(_PREFIX):
                self._call(tag.removeprefix(_PREFIX), element, into, scope)
            case tag:
                made = SubElement(into, tag)
                self._set_attributes(element, made, scope)
                self._expand_children(element, made, scope)
        self._depth -= 1

    def _set_attributes(self, source: Element, made: Element, scope: Scope) -> None:
        for name, text in source.items():
            if not name.startswith((_PREFIX, "xmlns:")):
                self._set(made, name, text, scope)

    def _set(self, made: Element, name: str, text: str, scope: Scope) -> None:
        value = str(self._text(text, scope))
        self._count(value)
        made.set(name, value)

    def _count(self, text: str) -> None:
        self._letters += len(text) + 1
        if self._letters > MAX_BYTES:
            raise CEIError(f"expanded it has more than {MAX_BYTES} letters")

    def _property(self, element: Element, scope: Scope) -> None:
        name = str(self._text(_required(element, "name"), scope))
        if not name.isidentifier() or iskeyword(name) or name.startswith("__"):
            raise CEIError(f"a property cannot be called {one_line(name, 60)!r}")
        value, default = element.get("value"), element.get("default")
        remove = truth(self._text(element.get("remove", "false"), scope), "remove")
        if (value is not None) + (default is not None) + remove > 1:
            raise CEIError(f"property {name!r} may have one of `value`, `default` and `remove`")
        if remove:
            scope.remove(name)
            return
        if default is not None:
            if name in scope:
                return
            value = default
        lazy, target = truth(self._text(element.get("lazy_eval", "true"), scope), "lazy_eval"), scope
        match element.get("scope"):
            case "global":
                lazy, target = False, [*scope.chain()][-1]
            case "parent" if scope.parent is not None:
                lazy, target = False, scope.parent
                while not scope.is_namespace and target.is_namespace and target.parent is not None:
                    target = target.parent
            case _:
                pass
        if value is None:
            target.blocks[f"**{name}"] = element
        else:
            target.set(name, value if lazy else self._text(value, scope), lazy)

    def _declare(self, element: Element, scope: Scope) -> None:
        name, default = _required(element, "name"), element.get("default")
        self._asked.add(name)
        if name not in self._arguments and default is not None:
            self._arguments[name] = str(self._text(default, scope))

    def _define(self, element: Element, scope: Scope) -> None:
        name = _required(element, "name").removeprefix(_PREFIX)
        if name == "call" or "." in name:
            raise CEIError(f"a macro cannot be called {one_line(name, 60)!r}")
        scope.macros[name] = Macro(element, *_parameters(element.get("params", "")))

    def _call(self, name: str, element: Element, into: Element, scope: Scope, without: tuple[str, ...] = ()) -> None:
        found = scope.macro(name)
        if found is None:
            known = {macro for each in scope.chain() for macro in each.macros}
            raise unknown("macro", one_line(name, 60), sorted(known))
        macro, around = found
        inner = Scope(self._text, around)
        missing = list(macro.parameters)
        for parameter, text in element.items():
            if parameter in without or parameter.startswith("xmlns:"):
                continue
            if parameter not in missing or parameter.startswith("*"):
                raise unknown(f"parameter of macro {name!r}", parameter, macro.parameters)
            missing.remove(parameter)
            inner.set(parameter, self._text(text, scope))
        given = Element("blocks")
        self._expand_children(element, given, scope)
        blocks = list(given)
        for parameter in [each for each in missing if each.startswith("*")]:
            if not blocks:
                raise CEIError(f"macro {name!r} is called without its block {parameter!r}")
            missing.remove(parameter)
            inner.blocks[parameter] = blocks.pop(0)
        if blocks:
            raise CEIError(f"macro {name!r} is called with <{blocks[0].tag}>, which is none of its blocks")
        for parameter in missing:
            inner.set(parameter, self._default(name, macro, parameter, scope))
        self._macros.append(name)
        self._expand_children(macro.body, into, inner)
        self._macros.pop()

    def _default(self, name: str, macro: Macro, parameter: str, scope: Scope) -> Value:
        forward, text = macro.defaults.get(parameter, (False, None))
        if forward and parameter in scope:
            return scope[parameter]
        if text is None:
            raise CEIError(f"macro {name!r} is called without its parameter {parameter!r}")
        return self._text(text, scope)

    def _insert(self, element: Element, into: Element, scope: Scope) -> None:
        name = _required(element, "name")
        if (found := scope.block(name)) is None:
            raise CEIError(f"there is no block {one_line(name, 60)!r}")
        block, content_only = found
        if content_only:
            self._expand_children(block, into, scope)
        else:
            self._expand(block, into, scope)

    def _include(self, element: Element, into: Element, scope: Scope) -> None:
        name = str(self._text(_required(element, "filename"), scope))
        if (space := element.get("ns")) is not None:
            inner = Scope(self._text, scope, is_namespace=True)
            scope.spaces[str(self._text(space, scope))] = inner
            scope = inner
        optional = truth(element.get("optional", "false"), "optional")
        with self._files.opened(name, optional) as tree:
            if tree is not None:
                self._expand_children(tree, into, scope)

    # -- texts ---------------------------------------------------------------------------------------------------------

    def _text(self, text: str, scope: Scope) -> Value:
        """What a text stands for: of one expression alone its value, else text."""
        self._count(text)
        values: list[Value] = []
        at = 0
        while at < len(text):
            if (part := _PARTS.match(text, at)) is None:
                raise CEIError(f"{one_line(text[at:], 80)!r} is not closed")
            at, found = part.end(), part.group()
            if found.startswith("$$") and found[-1] in "{(":
                values.append(found[1:])
            elif found.startswith("${"):
                values.append(self._evaluator.value(str(self._text(found[2:-1], scope)), scope))
            elif found.startswith("$("):
                values.append(self._substituted(str(self._text(found[2:-1], scope))))
            else:
                values.append(found)
        if len(values) == 1:
            return values[0]
        texts = [str(value) for value in values]
        if sum(map(len, texts)) > MAX_SIZE:
            raise CEIError(f"{one_line(text, 80)!r} is too long")
        return "".join(texts)

    def _substituted(self, command: str) -> str:
        """What `$(...)` stands for."""
        what, *words = command.split() or [""]
        match what, words:
            case "eval", [_, *_]:
                return str(
                    self._evaluator.value(command.partition(" ")[2], _Arguments(self._argument, self._arguments))
                )
            case "arg", [name]:
                return self._argument(name)
            case "find", [package]:
                return f"package://{package}"
            case "optenv", [name, *default]:
                note = f"$(optenv {name}) is not read; {' '.join(default)!r}, its default, is taken."
                self.notes += [note] * (note not in self.notes)
                return " ".join(default)
            case "env", [name]:
                raise CEIError(
                    f"$(env {one_line(name, 60)}): the environment is not read; make it an <xacro:arg>, and give it by `xacro_args`"
                )
            case _:
                raise CEIError(
                    f"$({one_line(command, 60)}) is not allowed; $(arg NAME), $(find PACKAGE) and $(eval ...) are"
                )

    def _argument(self, name: str) -> str:
        self._asked.add(str(name))
        if name not in self._arguments:
            raise CEIError(
                f"its argument {one_line(name, 60)!r} has no default; give it in the YAML, as `xacro_args: {{{one_line(name, 60)}: ...}}`."
            )
        return self._arguments[name]

    def _load_yaml(self, name: str) -> Value:
        content, work = self._files.load_yaml(name)
        self._evaluator.spend(work)
        return content

    def _fatal(self, *words: object) -> Value:
        raise Fault(one_line(" ".join(map(str, words))))

    def _said(self, *words: object) -> str:
        note = f"it warns: {one_line(' '.join(map(str, words)))}"
        self.notes += [note] * (note not in self.notes and len(self.notes) < 100)
        return ""


class _Arguments:
    """Names of `$(eval ...)`: arguments, as the numbers and truths that they are."""

    def __init__(self, argument: Callable[[str], str], known: Mapping[str, str]) -> None:
        self._argument, self._known = argument, known

    def __contains__(self, name: str) -> bool:
        return name in self._known

    def __getitem__(self, name: str) -> Value:
        return literal(self._argument(name))


def _argument(value: object) -> str:
    """An argument's text; a YAML's truth is xacro's."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _required(element: Element, attribute: str) -> str:
    if (text := element.get(attribute)) is None:
        raise CEIError(f"<{element.tag}> has no `{attribute}`")
    return text


def _parameters(text: str) -> tuple[list[str], dict[str, tuple[bool, str | None]]]:
    """Names and defaults of a macro's parameters, as in `prefix *origin mass:=1 parent:=^|world`."""
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
