"""A xacro's elements, expanded: macros, blocks, conditions, includes; bounded in depth, number and size."""

import re
from collections.abc import Mapping
from keyword import iskeyword
from xml.etree.ElementTree import Element, SubElement

from cei_gym.embodiment.resources import Place
from cei_gym.embodiment.xacro.files import Files
from cei_gym.embodiment.xacro.functions import Value
from cei_gym.embodiment.xacro.scope import Macro, Scope, parameters, truth
from cei_gym.embodiment.xacro.texts import Texts
from cei_gym.errors import CEIError, one_line, unknown
from cei_gym.untrusted_xml import MAX_ELEMENTS

_PREFIX = "xacro:"
_DEEPEST = 100
_NAME = re.compile(r"[A-Za-z_][\w.-]*(:[A-Za-z_][\w.-]*)?", re.ASCII)
_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_UNREAD = ("gazebo", "ros2_control", "transmission")  # of a <robot>: not read of a URDF, so they need not be expanded


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
    files = Files(place)
    texts = Texts(files, place.xacro_args | {**arguments})
    expander = _Expander(files, texts)
    try:
        expanded = expander.expanded(tree)
        texts.check_asked(arguments)
    except RecursionError:
        raise CEIError(f"{expander.where}its macros, includes or properties are nested too deeply") from None
    except CEIError as error:
        raise CEIError(f"{expander.where}{error}") from None
    return expanded, texts.notes


class _Expander:
    """One expansion: what was read, counted and given so far."""

    def __init__(self, files: Files, texts: Texts) -> None:
        self._files, self._texts = files, texts
        self._macros: list[str] = []
        self._depth = self._elements = 0

    @property
    def where(self) -> str:
        """The included file and the macro that are being expanded, to be put before a message."""
        parts = [name for name in [self._files.included] if name]
        if self._macros:
            parts.append(f"macro {self._macros[-1]!r}")
        return f"{', '.join(parts)}: " if parts else ""

    def expanded(self, tree: Element) -> Element:
        made, scope = Element(tree.tag), Scope(self._texts.value)
        self._expand_children(tree, made, scope)
        self._set_attributes(tree, made, scope)  # last: the arguments that they name are declared inside
        return made

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
                self._texts.declare(_required(element, "name"), element.get("default"), scope)
            case "xacro:include":
                self._include(element, into, scope)
            case "xacro:if" | "xacro:unless":
                text = _required(element, "value")
                if truth(self._texts.value(text, scope), text) is (element.tag == "xacro:if"):
                    self._expand_children(element, into, scope)
            case "xacro:insert_block":
                self._insert(element, into, scope)
            case "xacro:attribute":
                name = _name(self._texts.value(_required(element, "name"), scope))
                self._set(into, name, _required(element, "value"), scope)
            case "xacro:element":
                tag = _name(self._texts.value(_required(element, "xacro:name"), scope))
                made = Element(tag, {name: text for name, text in element.items() if name != "xacro:name"})
                made[:] = list(element)
                self._expand(made, into, scope)
            case "xacro:call":
                self._call(str(self._texts.value(_required(element, "macro"), scope)), element, into, scope, ("macro",))
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
        value = str(self._texts.value(text, scope))
        if _NO_XML.search(value):
            raise CEIError(f"{name}={one_line(text, 60)!r} has letters that no XML has")
        self._texts.count(value)
        made.set(name, value)

    def _property(self, element: Element, scope: Scope) -> None:
        name = str(self._texts.value(_required(element, "name"), scope))
        if not name.isidentifier() or iskeyword(name) or name.startswith("__"):
            raise CEIError(f"a property cannot be called {one_line(name, 60)!r}")
        value, default = element.get("value"), element.get("default")
        remove = truth(self._texts.value(element.get("remove", "false"), scope), "remove")
        if (value is not None) + (default is not None) + remove > 1:
            raise CEIError(f"property {name!r} may have one of `value`, `default` and `remove`")
        if remove:
            scope.remove(name)
            return
        if default is not None:
            if name in scope:
                return
            value = default
        lazy, target = truth(self._texts.value(element.get("lazy_eval", "true"), scope), "lazy_eval"), scope
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
            target.set(name, value if lazy else self._texts.value(value, scope), lazy)

    def _define(self, element: Element, scope: Scope) -> None:
        name = _required(element, "name").removeprefix(_PREFIX)
        if name == "call" or "." in name:
            raise CEIError(f"a macro cannot be called {one_line(name, 60)!r}")
        scope.macros[name] = Macro(element, *parameters(element.get("params", "")))

    def _call(self, name: str, element: Element, into: Element, scope: Scope, without: tuple[str, ...] = ()) -> None:
        found = scope.macro(name)
        if found is None:
            known = {macro for each in scope.chain() for macro in each.macros}
            raise unknown("macro", one_line(name, 60), sorted(known))
        macro, around = found
        inner = Scope(self._texts.value, around)
        missing = list(macro.parameters)
        for parameter, text in element.items():
            if parameter in without or parameter.startswith("xmlns:"):
                continue
            if parameter not in missing or parameter.startswith("*"):
                raise unknown(f"parameter of macro {name!r}", parameter, macro.parameters)
            missing.remove(parameter)
            inner.set(parameter, self._texts.value(text, scope))
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
        return self._texts.value(text, scope)

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
        name = str(self._texts.value(_required(element, "filename"), scope))
        if (space := element.get("ns")) is not None:
            inner = Scope(self._texts.value, scope, is_namespace=True)
            scope.spaces[str(self._texts.value(space, scope))] = inner
            scope = inner
        optional = truth(element.get("optional", "false"), "optional")
        with self._files.opened(name, optional) as tree:
            if tree is not None:
                self._expand_children(tree, into, scope)


def _name(value: Value) -> str:
    """The name of an element or attribute that an expression made; written out it must be nothing but that."""
    if not _NAME.fullmatch(str(value)):
        raise CEIError(f"{one_line(value, 60)!r} is no name of an element or attribute")
    return str(value)


def _required(element: Element, attribute: str) -> str:
    if (text := element.get(attribute)) is None:
        raise CEIError(f"<{element.tag}> has no `{attribute}`")
    return text
