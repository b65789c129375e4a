"""The texts of a xacro's attributes: `${...}`, `$(...)`, and what they stand for."""

import re
from collections.abc import Callable, Mapping

from cei_gym.embodiment.xacro.expressions import Evaluator
from cei_gym.embodiment.xacro.files import Files
from cei_gym.embodiment.xacro.functions import MAX_SIZE, Fault, Value
from cei_gym.embodiment.xacro.scope import Scope, literal
from cei_gym.errors import CEIError, one_line, unknown
from cei_gym.untrusted_xml import MAX_BYTES

_PARTS = re.compile(r"\$\$+[{(]|\$\{[^}]*\}|\$\([^)]*\)|[^$]+|\$(?![{($])[^$]*")
_MOST_NOTES = 100


class Texts:
    """The texts of one xacro.

    Args:
        files: what it reads.
        arguments: those of its `<xacro:arg>` that are given.

    Attributes:
        notes: sentences about what was assumed, and warnings of its own.
    """

    def __init__(self, files: Files, arguments: Mapping[str, object]) -> None:
        self.notes: list[str] = []
        self._files = files
        self._arguments = {name: _as_text(value) for name, value in arguments.items()}
        self._asked: set[str] = set()
        self._letters = 0
        self._evaluator = Evaluator(
            {
                "load_yaml": self._load_yaml,
                "xacro.load_yaml": self._load_yaml,
                "xacro.arg": self._argument,
                "xacro.fatal": self._fatal,
                **{f"xacro.{kind}": self._warning for kind in ("error", "warning")},
                **{f"xacro.{kind}": lambda *_: "" for kind in ("message", "print_location")},
            }
        )

    def value(self, text: str, scope: Scope) -> Value:
        """What a text stands for in a scope: of one expression alone its value, else text.

        Raises:
            CEIError: it has no value, or what is not allowed.
        """
        self.count(text)
        values: list[Value] = []
        at = 0
        while at < len(text):
            if (part := _PARTS.match(text, at)) is None:
                raise CEIError(f"{one_line(text[at : at + 60], 80)!r} is not closed")
            at, found = part.end(), part.group()
            if found.startswith("$$") and found[-1] in "{(":
                values.append(found[1:])
            elif found.startswith("${"):
                values.append(self._evaluator.value(str(self.value(found[2:-1], scope)), scope))
            elif found.startswith("$("):
                values.append(self._substituted(str(self.value(found[2:-1], scope))))
            else:
                values.append(found)
        if len(values) == 1:
            return values[0]
        texts = [str(value) for value in values]
        if sum(map(len, texts)) > MAX_SIZE:
            raise CEIError(f"{one_line(text[:60], 80)!r} is too long")
        return "".join(texts)

    def count(self, text: str) -> None:
        """Add to the letters that were read and made.

        Raises:
            CEIError: there are too many.
        """
        self._letters += len(text) + 1
        if self._letters > MAX_BYTES:
            raise CEIError(f"expanded it has more than {MAX_BYTES} letters")

    def declare(self, name: str, default: str | None, scope: Scope) -> None:
        """Have an argument, with a default where none is given."""
        self._asked.add(name)
        if name not in self._arguments and default is not None:
            self._arguments[name] = str(self.value(default, scope))

    def check_asked(self, names: Mapping[str, object]) -> None:
        """Refuse arguments that nothing asked for.

        Raises:
            CEIError: there is one; the message lists those that there are.
        """
        for name in names:
            if name not in self._asked:
                raise unknown("name in `xacro_args`", name, sorted(self._asked))

    def _substituted(self, command: str) -> str:
        """What `$(...)` stands for."""
        what, *words = command.split() or [""]
        match what, words:
            case "eval", [_, *_]:
                names = _Arguments(self._argument, self._arguments)
                return str(self._evaluator.value(command.partition(" ")[2], names))
            case "arg", [name]:
                return self._argument(name)
            case "find", [package]:
                return f"package://{package}"
            case "optenv", [name, *default]:
                self._note(f"$(optenv {name}) is not read; {' '.join(default)!r}, its default, is taken.")
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
            shown = one_line(name, 60)
            raise CEIError(
                f"its argument {shown!r} has no default; give it in the YAML, as `xacro_args: {{{shown}: ...}}`."
            )
        return self._arguments[name]

    def _load_yaml(self, name: str) -> Value:
        content, work = self._files.load_yaml(name)
        self._evaluator.spend(work)
        return content

    def _fatal(self, *words: object) -> Value:
        raise Fault(one_line(" ".join(map(str, words))))

    def _warning(self, *words: object) -> str:
        self._note(f"it warns: {one_line(' '.join(map(str, words)))}")
        return ""

    def _note(self, note: str) -> None:
        if note not in self.notes and len(self.notes) < _MOST_NOTES:
            self.notes.append(note)


class _Arguments:
    """Names of `$(eval ...)`: arguments, as the numbers and truths that they are."""

    def __init__(self, argument: Callable[[str], str], known: Mapping[str, str]) -> None:
        self._argument, self._known = argument, known

    def __contains__(self, name: str, /) -> bool:
        return name in self._known

    def __getitem__(self, name: str, /) -> Value:
        return literal(self._argument(name))


def _as_text(value: object) -> str:
    """An argument's text; a YAML's truth is xacro's."""
    return str(value).lower() if isinstance(value, bool) else str(value)
