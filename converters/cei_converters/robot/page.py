"""The page of `cei-robot show`: a panel beside the scene."""

import threading
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import viser

from cei_converters.robot.markup import text
from cei_converters.robot.pad_editing import PadEditor
from cei_converters.robot.pad_file import PadFile
from cei_converters.robot.pad_panel import PadPanel
from cei_converters.robot.scene import RobotScene
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment

_STEPS = {"rad": 0.001, "m": 0.0001}


class Server(viser.ViserServer):
    """A viser server that nobody can have open a tunnel to the world."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuses."""
        return None


class Page:
    """What is on the page, and what happens if it is used.

    Args:
        server: that shows it.
        embodiment: the robot.
        file: that pads are saved to; None if there are none.
    """

    def __init__(self, server: viser.ViserServer, embodiment: Embodiment, file: PadFile | None) -> None:
        self._gui, self._embodiment, self._file = server.gui, embodiment, file
        self._lock = threading.RLock()  # viser calls from many threads
        self._scene = RobotScene(server, embodiment)
        self._u = embodiment.coupled.reduce(embodiment.home)
        self._gui.set_panel_label(embodiment.name)
        self._gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(30, 90, 160))
        tabs = self._gui.add_tab_group()
        with tabs.add_tab("Joints"):
            self._add_joints()
        with tabs.add_tab("View"):
            self._add_view()
        if file is not None:
            with tabs.add_tab("Pads"):
                self._pads = PadPanel(self._gui, self._scene, PadEditor(embodiment), file, self._lock, self._shown_pads)
        self._pose()

    @property
    def qpos(self) -> Array:
        """(n,) joint positions as they are shown, rad or m."""
        return self._embodiment.coupled.expand(self._u)

    # -- joints -----------------------------------------------------------------------------------------------------

    def _add_joints(self) -> None:
        embodiment, hand = self._embodiment, self._embodiment.end_effector
        reset = self._gui.add_button("Reset all joints")
        if hand is None:
            reset.on_click(self._locked(lambda _: self._go(embodiment.home)))
        else:
            closing = self._gui.add_slider("closed", min=0.0, max=1.0, step=0.01, initial_value=0.0)
            closing.on_update(self._locked(lambda event: self._close(event.target.value)))
            group = self._gui.add_button_group("hand", ("home", "half", "closed"))
            shares = {"home": 0.0, "half": 0.5, "closed": 1.0}

            def pressed(event: viser.GuiEvent[Any]) -> None:
                closing.value = shares[event.target.value]
                self._close(closing.value)

            def rested(_: object) -> None:
                closing.value = 0.0
                self._go(embodiment.home)

            reset.on_click(self._locked(rested))
            group.on_click(self._locked(pressed))
        self._sliders: dict[int, viser.GuiSliderHandle[float]] = {}
        lower, upper = embodiment.independent_limits
        parts = [("arm", range(embodiment.n_arm)), ("hand", range(embodiment.n_arm, len(embodiment.joint_names)))]
        for part, joints in parts:
            mine = [(u, int(q)) for u, q in enumerate(embodiment.coupled.independent) if q in joints]
            if not mine:
                continue
            with self._gui.add_folder(f"Joints of the {part}"):
                for u, q in mine:
                    if lower[u] < upper[u]:
                        self._add_slider(u, q, float(lower[u]), float(upper[u]))
        self._followers = None
        if len(embodiment.coupled.independent) < len(embodiment.joint_names):
            with self._gui.add_folder("Joints that follow others", expand_by_default=False):
                self._followers = self._gui.add_html("")

    def _add_slider(self, u: int, q: int, lower: float, upper: float) -> None:
        name, unit = self._embodiment.joint_names[q], self._embodiment.joint_units[q]
        slider = self._gui.add_slider(
            f"{name} ({unit})",
            min=lower,
            max=upper,
            step=_STEPS[unit],
            initial_value=float(np.clip(self._u[u], lower, upper)),
            hint=f"{name}: from {lower:.4g} to {upper:.4g} {unit}",
        )
        self._sliders[u] = slider

        def moved(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:  # not by us
                self._u[u] = slider.value
                self._pose()

        slider.on_update(self._locked(moved))

    def _close(self, share: float) -> None:
        """Close the end-effector by a share in [0, 1]; the arm stays."""
        embodiment = self._embodiment
        qpos = (1 - share) * embodiment.home + share * embodiment.closed
        qpos[: embodiment.n_arm] = self.qpos[: embodiment.n_arm]
        self._go(qpos)

    def _go(self, qpos: Array) -> None:
        self._u = self._embodiment.coupled.reduce(qpos).copy()
        for u, slider in self._sliders.items():
            slider.value = float(self._u[u])
        self._pose()

    def _pose(self) -> None:
        embodiment, coupled = self._embodiment, self._embodiment.coupled
        qpos = self.qpos
        self._scene.pose(qpos)
        followers = [q for q in range(len(qpos)) if q not in coupled.independent]
        rows = [
            f"{embodiment.joint_names[q]}: {qpos[q]:.3f} {embodiment.joint_units[q]}, by"
            f" {embodiment.joint_names[coupled.independent[coupled.leader[q]]]}"
            for q in followers
        ]
        if self._followers is not None:
            self._followers.content = text(*rows)

    # -- what is seen -----------------------------------------------------------------------------------------------

    def _add_view(self) -> None:
        scene = self._scene
        inside: list[viser.GuiCheckboxHandle] = []  # of what would be hidden by meshes that are not of glass

        def revealed(handles: Iterable[Any], on: bool) -> None:
            show(handles, on)
            scene.glass(any(box.value for box in inside))

        self._switch("Meshes", True, lambda on: show(scene.visual.values(), on))
        inside.append(self._switch("Collision shapes", False, lambda on: revealed(scene.collision.values(), on)))
        if self._embodiment.end_effector is not None:
            self._pads_switch = self._switch("Pads: points and outward normals", True, scene.show_pads)
        with self._gui.add_folder("Frames (x red, y green, z blue)"):
            for name, handles in scene.frames.items():
                inside.append(self._switch(name, False, lambda on, handles=handles: revealed(handles, on)))
            self._switch("Names beside them", True, scene.show_names)
        if self._embodiment.notes:
            with self._gui.add_folder("What was assumed, and what is left out", expand_by_default=False):
                self._gui.add_html(text(*self._embodiment.notes))

    def _switch(self, label: str, on: bool, switched: Callable[[bool], None]) -> viser.GuiCheckboxHandle:
        box = self._gui.add_checkbox(label, on)
        box.on_update(self._locked(lambda _: switched(box.value)))
        return box

    def _shown_pads(self) -> bool:
        return self._pads_switch.value

    def _locked(self, func: Callable[[viser.GuiEvent[Any]], None]) -> Callable[[viser.GuiEvent[Any]], None]:
        def locked(event: viser.GuiEvent[Any]) -> None:
            with self._lock:
                func(event)

        return locked


def show(handles: Iterable[Any], shown: bool) -> None:
    """Have nodes of the scene be seen, or not."""
    for handle in handles:
        handle.visible = shown
