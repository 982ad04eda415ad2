#!/usr/bin/env python3
"""An independent implementation of the keys and seals of a `ble` link, written from section 3.1 of `PROTOCOL.md`:
Noise, the derivation of the keys, and the first SDUs in both directions. It uses the package `cryptography`.

usage: link_keys.py [--write]
Compares its result with the test vectors in crates/link-lanes/vectors/keys.json, or writes them.
"""

from __future__ import annotations

import argparse
import hashlib
import hmac
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import AESCCM, ChaCha20Poly1305

if TYPE_CHECKING:
    from collections.abc import Callable

VECTORS = Path(__file__).resolve().parents[2] / "crates" / "link-lanes" / "vectors"
NOISE = b"Noise_NNpsk2_25519_ChaChaPoly_SHA256"
VERSION = 2
SECRET = "fleet:a secret for test vectors"
# The head of a sealed message of the handshake.
SEALED_MESSAGE = b"\xf0"
SDUS_PER_KEY = 1 << 20


def derive(key: bytes, label: bytes) -> bytes:
    return hmac.new(key, label, hashlib.sha3_256).digest()


def psk_of(secret: str) -> bytes:
    return derive(secret.encode(), b"RECT link 2 psk")


def public_key(private: bytes) -> bytes:
    return X25519PrivateKey.from_private_bytes(private).public_key().public_bytes_raw()


def exchange(private: bytes, public: bytes) -> bytes:
    """X25519. The result for a key of low order, which the package rejects, is zero."""
    if public == bytes(32):
        return bytes(32)
    return X25519PrivateKey.from_private_bytes(private).exchange(X25519PublicKey.from_public_bytes(public))


class Noise:
    """The symmetric state of Noise (sections 5.1 and 5.2 of its specification)."""

    def __init__(self, prologue: bytes, psk: bytes, name: bytes = NOISE) -> None:
        self.hash = hashlib.sha256(name).digest() if len(name) > 32 else name.ljust(32, b"\0")
        self.chaining_key = self.hash
        self.key = b""
        self.psk = psk
        self.mix_hash(prologue)

    def mix_hash(self, data: bytes) -> None:
        self.hash = hashlib.sha256(self.hash + data).digest()

    def expand(self, material: bytes, outputs: int) -> list[bytes]:
        temporary = hmac.new(self.chaining_key, material, hashlib.sha256).digest()
        result, last = [], b""
        for number in range(1, outputs + 1):
            last = hmac.new(temporary, last + bytes([number]), hashlib.sha256).digest()
            result.append(last)
        return result

    def mix_key(self, material: bytes) -> None:
        self.chaining_key, self.key = self.expand(material, 2)

    def mix_key_and_hash(self, material: bytes) -> None:
        self.chaining_key, hashed, self.key = self.expand(material, 3)
        self.mix_hash(hashed)

    def ephemeral(self, public: bytes) -> None:
        """The token `e` of a handshake with a pre-shared key."""
        self.mix_hash(public)
        self.mix_key(public)

    def encrypt_nothing(self) -> bytes:
        """Encrypts an empty payload. Each message has a key of its own, so the nonce is 0."""
        tag = ChaCha20Poly1305(self.key).encrypt(bytes(12), b"", self.hash)
        self.mix_hash(tag)
        return tag

    def split(self) -> tuple[bytes, bytes]:
        one, two = self.expand(b"", 2)
        return one, two


class Seal:
    """Seals the SDUs of one direction."""

    def __init__(self, chain: bytes) -> None:
        self.chain = chain
        self.number = 0

    def seal(self, content: bytes) -> bytes:
        head, body = content[:1], content[1:]
        nonce = self.number.to_bytes(8, "little") + bytes(5)
        sealed = AESCCM(derive(self.chain, b"key")[:16], tag_length=8).encrypt(nonce, body, head)
        self.number += 1
        if self.number % SDUS_PER_KEY == 0:
            self.chain = derive(self.chain, b"next")
        return head + sealed


def hello(kind: int, node: int, name: bytes) -> bytes:
    mtu, window = 1000, 12000
    fixed = node.to_bytes(8, "little") + mtu.to_bytes(2, "little") + window.to_bytes(2, "little")
    return b"RECT" + bytes([kind, VERSION]) + fixed + bytes([len(name)]) + name


class Agreement:
    """The key agreement NNpsk2 after both messages, of which the dialler's has the ephemeral key `public`."""

    def __init__(self, header: bytes, psk: bytes, public: bytes, listener: bytes) -> None:
        noise = Noise(header, psk)
        # -> e
        noise.ephemeral(public)
        self.key = public + noise.encrypt_nothing()
        # <- e, ee, psk
        noise.ephemeral(public_key(listener))
        noise.mix_key(exchange(listener, public))
        noise.mix_key_and_hash(psk)
        self.answer = public_key(listener) + noise.encrypt_nothing()
        self.root = derive(b"".join(noise.split()), noise.hash)

    def export(self, use: bytes) -> bytes:
        return derive(self.root, b"RECT link 2 export " + use)

    def seals(self) -> tuple[Seal, Seal]:
        return Seal(derive(self.root, b"RECT link 2 dialler")), Seal(derive(self.root, b"RECT link 2 listener"))


def vectors() -> dict[str, object]:
    psk = psk_of(SECRET)
    dialler, listener = bytes(range(1, 33)), bytes(range(101, 133))
    header, answer_header = b"RECT" + bytes([4, VERSION]), b"RECT" + bytes([5, VERSION])
    agreement = Agreement(header, psk, public_key(dialler), listener)
    low_order = Agreement(header, psk, bytes(32), listener)
    # The key agreement of an `any` link that begins on TCP.
    on_tcp = Agreement(b"RECTM\x01" + header, psk, public_key(dialler), listener)
    first = SEALED_MESSAGE + hello(1, 5, b"wombat-1")
    contents = (
        [first, b"\x00a batch", b"\x10\x00\x02", b"\x40\x00"],
        [SEALED_MESSAGE + hello(2, 6, b"wombat-2"), b"\x05another batch", b"\x25", b"\x50\x18\x00"],
    )
    dialled, listened = (
        [{"content": content.hex(), "sealed": seal.seal(content).hex()} for content in of_side]
        for seal, of_side in zip(agreement.seals(), contents, strict=True)
    )
    return {
        "secret": SECRET,
        "dialler_ephemeral": dialler.hex(),
        "listener_ephemeral": listener.hex(),
        "pre_shared_key": psk.hex(),
        "key": (header + agreement.key).hex(),
        "key_answer": (answer_header + agreement.answer).hex(),
        "export_path": agreement.export(b"path").hex(),
        "dialler": dialled,
        "listener": listened,
        "low_order": {
            "key": (header + low_order.key).hex(),
            "key_answer": (answer_header + low_order.answer).hex(),
            "hello": low_order.seals()[0].seal(first).hex(),
        },
        "tcp": {
            "key": (header + on_tcp.key).hex(),
            "key_answer": (answer_header + on_tcp.answer).hex(),
            "any_key": on_tcp.export(b"any key").hex(),
            "any_tag": on_tcp.export(b"any tag").hex(),
        },
    }


def main(description: str | None, files: dict[Path, Callable[[], object]]) -> None:
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write the vectors")
    is_written = parser.parse_args().write
    different = []
    for path, compute in files.items():
        text = json.dumps(compute(), indent=2) + "\n"
        if is_written:
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)
        elif not path.exists() or path.read_text() != text:
            different.append(path)
    for path in different:
        print(f"{path} differs from what this implementation computes", file=sys.stderr)
    sys.exit(bool(different))


if __name__ == "__main__":
    main(__doc__, {VECTORS / "keys.json": vectors})
