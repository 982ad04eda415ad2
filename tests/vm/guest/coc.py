"""Provides plain LE L2CAP channels (SOCK_SEQPACKET) for tests in the guest, with nothing but Python.

Python's sockets do not support LE addresses of L2CAP, so `bind` and `connect` are called through the C library.
A channel is read without blocking in the kernel (`settimeout`): kernel 5.10.262 keeps the socket locked while a reader
waits in `recv`, and data that arrives in the meantime blocks the adapter's receiver, which is a deadlock.
"""

import ctypes
import os
import socket
import struct

AF_BLUETOOTH = 31
BTPROTO_L2CAP = 0
SOL_BLUETOOTH = 274
BT_RCVMTU = 13
LE_PUBLIC = 1

_libc = ctypes.CDLL(None, use_errno=True)


def _call(function, sock, address, psm):
    # struct sockaddr_l2: family, psm, bdaddr (last byte first), cid, bdaddr_type
    bdaddr = bytes.fromhex(address.replace(":", ""))[::-1]
    raw = struct.pack("<HH6sHB", AF_BLUETOOTH, psm, bdaddr, 0, LE_PUBLIC) + b"\0"
    if function(sock.fileno(), raw, len(raw)) != 0:
        code = ctypes.get_errno()
        raise OSError(code, f"{function.__name__} {address}: {os.strerror(code)}")


def _socket(local, psm, mtu, timeout):
    sock = socket.socket(AF_BLUETOOTH, socket.SOCK_SEQPACKET, BTPROTO_L2CAP)
    _call(_libc.bind, sock, local, psm)
    sock.setsockopt(SOL_BLUETOOTH, BT_RCVMTU, struct.pack("H", mtu))
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", timeout, 0))
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", timeout, 0))
    return sock


def listen(local, psm=128, mtu=65535, timeout=30):
    """Returns a listening socket on the adapter with this address, for `accept`. `mtu` is the largest SDU that is
    received, in bytes; `timeout` is in seconds."""
    sock = _socket(local, psm, mtu, timeout)
    sock.listen(8)
    return sock


def accept(listener, timeout=30):
    """Returns the next channel. (Not every Python version can read an LE peer's address in its own `accept`.)"""
    fd = _libc.accept(listener.fileno(), None, None)
    if fd < 0:
        code = ctypes.get_errno()
        raise OSError(code, f"accept: {os.strerror(code)}")
    sock = socket.socket(AF_BLUETOOTH, socket.SOCK_SEQPACKET, BTPROTO_L2CAP, fileno=fd)
    sock.settimeout(timeout)
    return sock


def connect(local, peer, psm=128, mtu=65535, timeout=30):
    """Opens a channel from the adapter `local` to the listener on `peer`, which must be advertising."""
    sock = _socket(local, 0, mtu, timeout)
    _call(_libc.connect, sock, peer, psm)
    sock.settimeout(timeout)
    return sock
