"""A TCP hop with a limited rate in each direction, for comparing programs at the same rate.

It stores little itself, so that messages wait in the compared programs: 1000 bytes "on the air", and in each of its
socket buffers the equivalent of 8 kB (twice that as the kernel counts, including its bookkeeping). Segments have the
size of Ethernet's instead of the loopback's 64 kB, which would enlarge the senders' buffers. The sockets of the
programs are not changed."""

import contextlib
import socket
import threading
import time

from robots import RobotError

CHUNK_BYTES = 1000
BUFFER_BYTES = 8192
SEGMENT_BYTES = 1448
# The delay that a sleep of too long may catch up.
SLACK_S = 0.005


class Shaper:
    """Listens on `port`, and forwards connections to 127.0.0.1:`target`."""

    def __init__(self, bytes_per_s: float, target: int) -> None:
        self._bytes_per_s = bytes_per_s
        self._target = target
        self.carried = 0
        #: `on`; `silent`: nothing arrives, but connections stay open; `off`: connections end, and new ones fail.
        self.state = "on"
        self.connections = 0
        #: When the first connection was forwarded, on the monotonic clock; since it was set to `None`.
        self.connected_at: float | None = None
        self._listener = small_socket()
        self._listener.bind(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]

    def __enter__(self) -> "Shaper":
        self._listener.listen()
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                one, _ = self._listener.accept()
            except OSError:  # The listener was closed.
                return
            if self.state == "off":
                one.close()
                continue
            other = small_socket()
            try:
                other.connect(("127.0.0.1", self._target))
            except OSError as error:
                raise RobotError(f"no program listens behind the shaper: {error}") from error
            self.connections += 1
            self.connected_at = self.connected_at or time.monotonic()
            for source, sink in ((one, other), (other, one)):
                source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=self._carry, args=(source, sink), daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket) -> None:
        free_at = time.monotonic()
        try:
            while chunk := source.recv(CHUNK_BYTES):
                free_at = max(free_at, time.monotonic() - SLACK_S) + len(chunk) / self._bytes_per_s
                time.sleep(max(0.0, free_at - time.monotonic()))
                while self.state == "silent":
                    time.sleep(SLACK_S)
                if self.state == "off":
                    break
                sink.sendall(chunk)
                self.carried += len(chunk)
        except OSError:
            pass  # One of the two sides was closed.
        for end in (source, sink):
            # Also ends a receive of the other direction.
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()


def small_socket() -> socket.socket:
    small = socket.socket()
    small.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
    small.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
    small.setsockopt(socket.IPPROTO_TCP, socket.TCP_MAXSEG, SEGMENT_BYTES)
    return small
