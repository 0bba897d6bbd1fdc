"""A wire to a viewer that can be cut.

Rerun waits without end for a viewer that has stopped answering (a machine asleep, a network gone), when a stream is
closed and again when the program ends. Bytes that pass through a socket of our own can be stopped there: Rerun then
sees a broken connection, and gives up at once.
"""

import contextlib
import socket
import threading

__all__ = ["Relay"]

PIECE = 1 << 18


class Relay:
    """Passes bytes between a port of this machine and one elsewhere until it is cut.

    Attributes:
        port: of this machine, on which it listens.
    """

    def __init__(self, host: str, port: int) -> None:
        """Listen; the other side is called when somebody calls here.

        Args:
            host: of the other side.
            port: of the other side.
        """
        self._other = (host, port)
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._sockets = [self._listening]
        self.port: int = self._listening.getsockname()[1]
        threading.Thread(target=self._answer, daemon=True).start()

    def cut(self) -> None:
        """Close both sides of every connection, whatever is on its way."""
        for one in self._sockets:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def _answer(self) -> None:
        with contextlib.suppress(OSError):  # cut, or the other side is gone
            while True:
                here, _ = self._listening.accept()
                self._sockets.append(here)
                there = socket.create_connection(self._other)
                self._sockets.append(there)
                for pair in ((here, there), (there, here)):
                    threading.Thread(target=_pass_on, args=pair, daemon=True).start()


def _pass_on(giver: socket.socket, taker: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while piece := giver.recv(PIECE):
            taker.sendall(piece)
    for one in (giver, taker):  # what is broken on one side is broken on the other
        with contextlib.suppress(OSError):
            one.shutdown(socket.SHUT_RDWR)
