"""Where a Rerun viewer is, whether it answers, and opening one."""

import importlib.util
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from modal.recording.names import label
from okid.errors import InvalidDataError

__all__ = ["HOST", "PATIENCE", "host_and_port", "listens", "open_viewer", "speaks"]

HOST: Final = "127.0.0.1"
PORT: Final = 9876
"""Where a Rerun viewer listens unless it is told otherwise."""

SETTINGS: Final = b"\x00\x00\x00\x04\x00\x00\x00\x00\x00"
"""A frame of HTTP/2 without content: its length, its type, flags, stream 0."""

PATIENCE: Final = 1.0
"""Seconds to wait for an answer when the viewer is sought."""

OPENING: Final = 2.0
"""Seconds to wait for a viewer that was opened."""


def host_and_port(address: str | None) -> tuple[str, int]:
    """Of an address host:port or rerun+http://host:port/proxy; the usual one of this machine for None.

    Raises:
        InvalidDataError: it is none.
    """
    if address is None:
        return HOST, PORT
    parts = urlsplit(address if "://" in address else f"//{address}")
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if not host or (parts.scheme and not parts.scheme.startswith("rerun")):
        raise InvalidDataError(
            f"the address of a viewer is host:port or rerun+http://host:port/proxy, but is {label(address, 80)!r}."
        )
    return host, port or PORT


def listens(host: str, port: int) -> bool:
    """Whether anybody takes a connection there."""
    try:
        socket.create_connection((host, port), timeout=PATIENCE).close()
    except OSError:
        return False
    return True


def speaks(host: str, port: int) -> bool:
    """Whether the protocol of a viewer is spoken there: Rerun itself would wait for an answer without end.

    References:
        RFC 9113, HTTP/2, section 3.4: both sides begin with a SETTINGS frame. doi 10.17487/RFC9113
    """
    try:
        with socket.create_connection((host, port), timeout=PATIENCE) as one:
            one.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + SETTINGS)
            answer = one.recv(len(SETTINGS))
    except OSError:
        return False
    return len(answer) == len(SETTINGS) and answer[3] == SETTINGS[3]


def open_viewer(port: int) -> str:
    """Open a viewer on this machine and wait a moment for it; in words why there is none, "" where there is."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return f"No Rerun viewer listens at port {port}, and this machine has no display to open one on."
    package = importlib.util.find_spec("rerun_cli")
    if package is None or package.origin is None:
        return "The Rerun viewer is not installed beside rerun-sdk."
    program = Path(package.origin).parent / ("rerun.exe" if os.name == "nt" else "rerun")
    try:
        subprocess.Popen(  # noqa: S603 - the viewer that came with rerun-sdk, and a number
            [program, "--port", str(port), "--hide-welcome-screen"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    except OSError as error:
        return f"A Rerun viewer could not be opened ({label(str(error), 80)})."
    end = time.perf_counter() + OPENING
    while time.perf_counter() < end:
        if listens(HOST, port):
            return ""
        time.sleep(0.05)
    return f"The Rerun viewer that was opened did not answer at port {port} within {OPENING:g} s."
