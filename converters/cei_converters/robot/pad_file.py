"""The YAML that edited pads are saved to."""

from collections.abc import Sequence
from pathlib import Path

import cei_gym
from cei_converters.cli.outputs import JOINT_MAP, Output, Outputs
from cei_converters.robot.pads_block import Sourced, replace_pads
from cei_gym.embodiment import EndEffectorSpec, build_embodiment, load_spec
from cei_gym.errors import CEIError
from cei_gym.functional import sample_representation

_SHIPPED = Path(cei_gym.__file__).resolve().parent


class PadFile:
    """An end-effector's YAML, and where it is saved with other pads.

    Args:
        source: the YAML.
        output: file to write instead.
        overwrite: whether that may be there already.

    Raises:
        CEIError: the output cannot be written, or must not replace what is there.
    """

    def __init__(self, source: Path, output: Path | None = None, overwrite: bool = False) -> None:
        self.path = source if output is None else output
        self._source, self._text, self._written = source, _read(source), False
        self._output: Output | None = None
        if output is not None:
            self._output = _writable("--output", output, overwrite)

    def save(self, pads: Sequence[Sourced]) -> list[Sourced]:
        """Write the YAML with these pads, if it then loads; returns them, each as one of the file's.

        Raises:
            CEIError: it must not be written, or would not load; the file is as it was.
        """
        output = self._output or _writable("--robot", self._source, overwrite=True)
        before = self.path if self._written else self._source
        if _read(before) != self._text:
            raise CEIError(f"{before} was changed by somebody else meanwhile; open it anew, or save with --output.")
        text = replace_pads(self._text, pads)
        with output.whole() as partial:
            partial.write_bytes(text.encode())
            spec = load_spec(EndEffectorSpec, partial)
            sample_representation(build_embodiment(None, spec))
        self._text, self._written = text, True
        self._output = Output(output.path, replaces=True)
        return [(i, pad) for i, (_, pad) in enumerate(pads)]


def _writable(option: str, path: Path, overwrite: bool) -> Output:
    """The file that an option names, to write to.

    Raises:
        CEIError: it must not be written to.
    """
    if path.resolve().is_relative_to(_SHIPPED):
        raise CEIError(
            f"{path.stem} ships with CEI-Gym and is not overwritten; start with --output=<file>.yaml to save a copy with these pads, or"
            f" copy {path} into a folder of yours and open it there."
        )
    output = Outputs(overwrite).file(option, path, JOINT_MAP)
    assert output is not None
    return output


def _read(path: Path) -> str:
    """A file's text with its line ends as they are.

    Raises:
        CEIError: it cannot be read.
    """
    try:
        return path.read_bytes().decode()
    except (OSError, ValueError) as error:
        raise CEIError(f"{path} cannot be read: {error}.") from error
