"""The part of the page that edits pads."""

import threading
from collections.abc import Callable
from typing import Any

import viser

from cei_converters.robot.markup import text
from cei_converters.robot.pad_editing import AUTO, CLICKED, PALMAR, Click, PadEditor
from cei_converters.robot.pad_file import PadFile
from cei_converters.robot.scene import RobotScene
from cei_gym.errors import CEIError, one_line
from cei_gym.functional.picture import pad_colour

POINTS = 128
"""Points of all pads together."""

_NONE = "none: look only"


class PadPanel:
    """The part of the panel that edits pads.

    Args:
        gui: to which it is added.
        scene: in which pads are drawn and clicked.
        editor: of the pads.
        file: that they are saved to.
        lock: of what the panel and others change; viser calls from many threads.
        shown: whether pads are seen.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        scene: RobotScene,
        editor: PadEditor,
        file: PadFile,
        lock: threading.RLock,
        shown: Callable[[], bool],
    ) -> None:
        self._gui, self._scene, self._editor, self._file, self._shown = gui, scene, editor, file, shown
        self._lock = lock
        self._sampled: dict[int, tuple[Any, Any]] = {}
        self._clickable = False
        self._choice = gui.add_dropdown("edit pad", self._options(), hint="Then click on the robot.")
        self._about = gui.add_html("")
        self._start = gui.add_slider("extent from", min=0.0, max=1.0, step=0.01, initial_value=0.0)
        self._end = gui.add_slider("extent to", min=0.0, max=1.0, step=0.01, initial_value=1.0)
        self._palmar = gui.add_dropdown("palmar", PALMAR)
        self._share = gui.add_number("share", 1.0, min=0.01, step=0.1)
        self._remove = gui.add_button("Remove this pad", color="gray")
        self._inputs = (self._start, self._end, self._palmar, self._share, self._remove)
        gui.add_button("New pad").on_click(self._does(lambda: editor.add()))
        gui.add_button("Save", color="green", hint=str(file.path)).on_click(self._does(self._save))
        self._status = gui.add_html("")
        self._choice.on_update(self._does(self._choose))
        self._start.on_update(self._does(self._extend))
        self._end.on_update(self._does(self._extend))
        self._palmar.on_update(self._does(lambda: editor.face(self._palmar.value)))
        self._share.on_update(self._does(lambda: editor.change(share=self._share.value)))
        self._remove.on_click(self._does(editor.remove))
        self._refresh("")

    def _options(self) -> tuple[str, ...]:
        return (_NONE, *self._editor.names())

    def _choose(self) -> None:
        index = self._options().index(self._choice.value) - 1
        self._editor.choose(None if index < 0 else index)

    def _extend(self) -> None:
        self._editor.change(extent=(self._start.value, self._end.value))

    def _save(self) -> str:
        self._editor.pads = self._file.save(self._editor.finished())
        return f"Saved to {self._file.path}."

    def _clicked(self, at: Click) -> None:
        self._do(lambda: self._editor.click(at))

    def _does(self, what: Callable[[], str | None]) -> Callable[[viser.GuiEvent[Any]], None]:
        """A callback; values that this class sets itself are no events."""

        def does(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                self._do(what)

        return does

    def _do(self, what: Callable[[], str | None]) -> None:
        with self._lock:
            try:
                said, wrong = what() or "", False
            except (CEIError, OSError) as error:
                said, wrong = one_line(error, 600), True
            self._refresh(said, wrong)

    def _refresh(self, said: str, wrong: bool = False) -> None:
        """Show pads, and controls, as they are now."""
        editor, pad = self._editor, self._editor.pad
        if self._choice.options != self._options():
            self._choice.options = self._options()
        self._choice.value = self._options()[0 if editor.chosen is None else editor.chosen + 1]
        for each in self._inputs:
            each.visible = pad is not None
        if self._clickable != (pad is not None):
            self._clickable = pad is not None
            self._scene.on_click(self._clicked if self._clickable else None)
        if pad is None:
            self._about.content = text("Choose a pad, or add one; then click on the robot.", *self._legend())
        else:
            self._start.value, self._end.value = pad.extent if len(pad.extent) == 2 else (0.0, 1.0)
            self._share.value, self._palmar.value = pad.share, CLICKED if editor.follows_clicks else AUTO
            geoms = ", ".join(pad.geoms) or "all that touches"
            faces = pad.palmar if isinstance(pad.palmar, str) else f"along {pad.palmar} of the link"
            self._about.content = text(
                f"link: {pad.body or '-'}",
                f"surfaces: {geoms}",
                f"faces: {faces}",
                "A click on the robot adds or removes a surface; one on another link moves the pad there. To choose what touches in"
                " physics, have the View show collision shapes.",
                *self._legend(),
            )
        failed = self._draw()
        self._status.content = text(said, colour="#b00020" if wrong else "#1b6e2f") + text(*failed, colour="#b00020")

    def _legend(self) -> list[tuple[str, str]]:
        return [(name, "rgb({},{},{})".format(*pad_colour(i))) for i, name in enumerate(self._editor.names())]

    def _draw(self) -> list[str]:
        """Draw pads; returns what is wrong with those that have no points."""
        drawn: list[tuple[Any, tuple[int, int, int]]] = []
        failed: list[str] = []
        shares = sum(pad.share for _, pad in self._editor.pads)
        for i, (_, pad) in enumerate(self._editor.pads):
            known, found = self._sampled.get(i, (None, None))
            if known != (pad, shares):
                try:
                    found = self._editor.sample(i, POINTS)
                except CEIError as error:
                    found = f"pad {i + 1}: {error}"
                self._sampled[i] = (pad, shares), found
            if isinstance(found, str):
                failed.append(found)
            else:
                drawn.append((found, pad_colour(i)))
        self._scene.draw_pads(drawn, self._shown())
        return failed
