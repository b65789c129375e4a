"""Headless Chromium, told what to do by its own protocol for developers."""

import base64
import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.request import urlopen

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
PATIENCE_S = 180.0
"""How long a page may take to do what it is to do, before a test fails rather than waits forever."""
_WEBGL = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


class Page:
    """One page. Places are in its pixels, from the upper left."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._count = socket, 0

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """A method of the protocol, and its result."""
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while (answer := json.loads(self._socket.recv(timeout=300))).get("id") != self._count:
            pass
        assert "error" not in answer, answer
        return answer["result"]

    def evaluate(self, script: str) -> Any:
        """The value of a JavaScript expression."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, script: str) -> Any:
        """The expression's value, once it is true.

        Raises:
            AssertionError: it is not, after minutes.
        """
        end = time.monotonic() + PATIENCE_S
        while not (value := self.evaluate(script)):
            assert time.monotonic() < end, f"not so: {script}; the page says: {self.text()}"
            time.sleep(0.1)
        return value

    def text(self) -> str:
        """All that the page says."""
        return self.evaluate("document.body.innerText")

    def place(self, label: str, control: str | None = None) -> tuple[float, float]:
        """The middle of the last element that says this and nothing else, scrolled into view; or of the control (a selector) beside it."""
        script = f"""(() => {{
          const says = [...document.querySelectorAll("body *")].filter(e =>
            e.textContent.trim() === {json.dumps(label)} && e.getClientRects().length);
          let e = says[says.length - 1];
          const control = {json.dumps(control)};
          while (e && control && !e.querySelector(control)) e = e.parentElement;
          if (e && control) e = e.querySelector(control);
          if (!e) return null;
          e.scrollIntoView({{block: "nearest"}});
          const box = e.getBoundingClientRect();
          return [box.x + box.width / 2, box.y + box.height / 2];
        }})()"""
        x, y = self.wait(script)
        return x, y

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """A mouse's event."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def click(self, x: float, y: float) -> None:
        """The left button pressed and let go."""
        self.mouse("mouseMoved", x, y)
        time.sleep(0.3)  # a frame is drawn, in which what is under the mouse is found
        for kind in ("mousePressed", "mouseReleased"):
            self.mouse(kind, x, y, button="left", buttons=1, clickCount=1)

    def press(self, label: str, control: str | None = None) -> None:
        """A click on `place`, once it stays where it is."""
        before, place = None, self.place(label, control)
        while place != before:
            time.sleep(0.3)
            before, place = place, self.place(label, control)
        self.click(*place)

    def picture(self, path: Path) -> None:
        """What is seen, as a PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))


@contextmanager
def browse(url: str, profile: Path, width: int = 1280, height: int = 800) -> Iterator[Page]:
    """Open a page in a browser of its own.

    Args:
        url: of the page.
        profile: empty folder.
        width, height: pixels.
    """
    from websockets.sync.client import connect

    options = ["--headless", "--no-sandbox", "--disable-background-networking", "--hide-scrollbars", *_WEBGL]
    options += [f"--user-data-dir={profile}", "--remote-debugging-port=0", f"--window-size={width},{height}"]
    process = subprocess.Popen([str(CHROMIUM), *options, "about:blank"], stderr=subprocess.DEVNULL)
    try:
        port_file = profile / "DevToolsActivePort"
        end = time.monotonic() + PATIENCE_S
        while not port_file.exists() or len(port_file.read_text().split()) < 2:
            assert process.poll() is None, "the browser ended"
            assert time.monotonic() < end, "the browser does not begin"
            time.sleep(0.1)
        port = port_file.read_text().split()[0]
        with urlopen(f"http://127.0.0.1:{port}/json/list") as answer:
            target = next(each for each in json.load(answer) if each["type"] == "page")
        with connect(target["webSocketDebuggerUrl"], max_size=None) as socket:
            page = Page(socket)
            page.call(
                "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
            )
            page.call("Page.navigate", url=url)
            yield page
    finally:
        process.kill()  # it has nothing to keep, and asked kindly it may never end
        process.wait()
