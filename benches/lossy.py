"""A hop that loses packets, for comparing TCP and UDP with a radio under the same conditions.

Of UDP, a datagram is lost. Of TCP, a chunk and all that follow it are delayed by the time after which Linux sends a
segment again, since TCP has to deliver them in order."""

import contextlib
import random
import socket
import threading
import time

#: Linux's shortest time until TCP sends a segment again (RTO_MIN).
RESEND_S = 0.2
CHUNK_BYTES = 1448


class LossyTcp:
    """Listens on `port`, and forwards connections to 127.0.0.1:`target`."""

    def __init__(self, target: int) -> None:
        self.share = 0.0
        self._target = target
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._listener.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                one, _ = self._listener.accept()
                other = socket.create_connection(("127.0.0.1", self._target))
                for source, sink in ((one, other), (other, one)):
                    source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    threading.Thread(target=self._carry, args=(source, sink), daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket) -> None:
        chance = random.Random(1)
        with contextlib.suppress(OSError):
            while chunk := source.recv(CHUNK_BYTES):
                while chance.random() < self.share:
                    time.sleep(RESEND_S)
                sink.sendall(chunk)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


class LossyUdp:
    """Receives at `port`, and forwards datagrams to 127.0.0.1:`target` and back."""

    def __init__(self, target: int) -> None:
        self.share = 0.0
        self._target = ("127.0.0.1", target)
        self._near = udp_socket()
        self._far = udp_socket()
        self._client: tuple[str, int] | None = None
        self.port = self._near.getsockname()[1]
        for carry in (self._forward, self._back):
            threading.Thread(target=carry, daemon=True).start()

    def close(self) -> None:
        self._near.close()
        self._far.close()

    def _forward(self) -> None:
        chance = random.Random(1)
        with contextlib.suppress(OSError):
            while True:
                datagram, self._client = self._near.recvfrom(65_536)
                if chance.random() >= self.share:
                    self._far.sendto(datagram, self._target)

    def _back(self) -> None:
        chance = random.Random(2)
        with contextlib.suppress(OSError):
            while True:
                datagram = self._far.recv(65_536)
                if self._client and chance.random() >= self.share:
                    self._near.sendto(datagram, self._client)


def udp_socket() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    return made
