"""`cei-robot show`: a robot in the browser."""

import contextlib
import errno
import io
import logging
import socket
import threading
from dataclasses import dataclass
from pathlib import Path

from cei_converters.cli import run
from cei_converters.cli.options import check_range
from cei_gym import extras
from cei_gym.errors import CEIError

EXAMPLE = """example:
  cei-robot show UR5e-Inspire
  cei-robot show robots/end_effectors/MyHand.yaml
  cei-robot show Inspire --output=robots/end_effectors/MyInspire.yaml"""
WHO = "cei-robot show"


@dataclass
class ShowConfig:
    """Show a robot in the browser: joints on sliders, frames, what touches, pads with normals, which clicks edit."""

    robot: str  # Name of an arm, an end-effector or <Arm>-<EndEffector>, or a YAML of an arm or end-effector.
    output: Path | None = None  # YAML that edited pads are saved to, instead of the end-effector's own.
    overwrite: bool = False  # Replace --output if it is there already.
    port: int = 8080  # Of the page; 0 is any that is free.
    host: str = "localhost"  # Address to listen on; whoever can reach it can move the robot and save pads.
    package_path: list[Path] | None = None  # Folders to look for ROS packages in, separated by colons.

    def __post_init__(self) -> None:
        check_range("--port", self.port, 0, 65535)
        if self.overwrite and self.output is None:
            raise CEIError("--overwrite is of no use without --output.")


def show(config: ShowConfig) -> None:
    """Show it until a signal comes.

    Raises:
        CEIError: no such robot, no such place to listen, or a file that must not be replaced.
    """
    extras.require(WHO, "show")
    check_free(config.host, config.port)
    from cei_converters.robot.opening import open_robot
    from cei_converters.robot.pad_file import PadFile
    from cei_gym.embodiment import use_package_path

    use_package_path(config.package_path)
    robot = open_robot(config.robot)
    file = None
    if robot.end_effector_file is not None:
        file = PadFile(robot.end_effector_file, config.output, config.overwrite)
    elif config.output is not None:
        raise CEIError(f"--output is of no use with {robot.embodiment.name}, which has no end-effector, so no pads.")

    from cei_converters.robot.page import Page, Server

    logging.getLogger("websockets").setLevel(logging.CRITICAL)  # a visitor who speaks no HTTP is no matter of ours
    with _quiet():
        server = Server(host=config.host, port=config.port, verbose=False)
    try:
        if config.port not in (0, server.get_port()):
            raise taken(config.port)
        Page(server, robot.embodiment, file)
        for note in robot.embodiment.notes:
            print(f"note: {note}")
        host = f"[{config.host}]" if ":" in config.host else config.host
        print(
            f"{robot.embodiment.name} is shown at http://{host}:{server.get_port()}/ until you press Ctrl-C.",
            flush=True,
        )
        threading.Event().wait()
    finally:
        with _quiet():
            server.stop()


def check_free(host: str, port: int) -> None:
    """Check that a page can be served.

    Raises:
        CEIError: something else listens there, or nobody can.
    """
    try:
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        raise CEIError(f"--host={host} is no address of this machine; localhost is one.") from None
    free = False
    for family, kind, protocol, _, address in addresses:
        try:
            with socket.socket(family, kind, protocol) as each:
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if family == socket.AF_INET6:
                    each.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                each.bind(address)
                free = True
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise taken(port) from None
            if error.errno == errno.EACCES:
                raise CEIError(f"--port={port} is for the system's own services; choose one above 1023.") from None
    if not free:
        raise CEIError(f"--host={host} is no address of this machine; localhost is one.")


def _quiet() -> contextlib.AbstractContextManager[object]:
    """Without viser's own words, which are of more than one line."""
    return contextlib.redirect_stdout(io.StringIO())


def taken(port: int) -> CEIError:
    """The error of a port that something else listens on."""
    return CEIError(f"--port={port} is taken; choose another, or --port=0 for any that is free.")


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-robot show`."""
    return run(ShowConfig, show, args, prog=WHO, example=EXAMPLE)
