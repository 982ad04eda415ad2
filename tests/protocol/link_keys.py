#!/usr/bin/env python3
"""An independent implementation of the keys and seals of a `ble` link, written from section 3.1 of `PROTOCOL.md`:
Noise, the derivation of the keys, and the first SDUs in both directions. It uses the package `cryptography`.

usage: link_keys.py [--write]
Compares its result with the test vectors in crates/link-lanes/vectors/version-2.json, or writes them.
"""

from __future__ import annotations

import argparse
import hashlib
import hmac
import json
import sys
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import AESCCM, ChaCha20Poly1305

VECTORS = Path(__file__).resolve().parents[2] / "crates" / "link-lanes" / "vectors" / "version-2.json"
NOISE = b"Noise_NNpsk2_25519_ChaChaPoly_SHA256"
VERSION = 2
# The head of a sealed message of the handshake.
SEALED_MESSAGE = b"\xf0"
SDUS_PER_KEY = 1 << 20


def derive(key: bytes, label: bytes) -> bytes:
    return hmac.new(key, label, hashlib.sha3_256).digest()


class Noise:
    """The symmetric state of Noise (sections 5.1 and 5.2 of its specification), and the two messages of NNpsk2."""

    def __init__(self, prologue: bytes, psk: bytes) -> None:
        self.hash = hashlib.sha256(NOISE).digest() if len(NOISE) > 32 else NOISE.ljust(32, b"\0")
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


def vectors() -> dict[str, object]:
    secret = "fleet:a secret for test vectors"
    psk = derive(secret.encode(), b"RECT link 2 psk")
    dialler, listener = bytes(range(1, 33)), bytes(range(101, 133))
    header = b"RECT" + bytes([4, VERSION])
    public = [X25519PrivateKey.from_private_bytes(key).public_key().public_bytes_raw() for key in (dialler, listener)]
    noise = Noise(header, psk)
    # -> e
    noise.ephemeral(public[0])
    key = public[0] + noise.encrypt_nothing()
    # <- e, ee, psk
    noise.ephemeral(public[1])
    shared = X25519PrivateKey.from_private_bytes(dialler).exchange(X25519PublicKey.from_public_bytes(public[1]))
    noise.mix_key(shared)
    noise.mix_key_and_hash(psk)
    answer = public[1] + noise.encrypt_nothing()
    root = derive(b"".join(noise.split()), noise.hash)
    seals = Seal(derive(root, b"RECT link 2 dialler")), Seal(derive(root, b"RECT link 2 listener"))
    contents = (
        [SEALED_MESSAGE + hello(1, 5, b"wombat-1"), b"\x00a batch", b"\x10\x00\x02", b"\x40\x00"],
        [SEALED_MESSAGE + hello(2, 6, b"wombat-2"), b"\x05another batch", b"\x25", b"\x50\x18\x00"],
    )
    dialled, listened = (
        [{"content": content.hex(), "sealed": seal.seal(content).hex()} for content in of_side]
        for seal, of_side in zip(seals, contents, strict=True)
    )
    return {
        "secret": secret,
        "dialler_ephemeral": dialler.hex(),
        "listener_ephemeral": listener.hex(),
        "pre_shared_key": psk.hex(),
        "key": (header + key).hex(),
        "key_answer": (b"RECT" + bytes([5, VERSION]) + answer).hex(),
        "export_path": derive(root, b"RECT link 2 export path").hex(),
        "dialler": dialled,
        "listener": listened,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write the vectors")
    text = json.dumps(vectors(), indent=2) + "\n"
    if parser.parse_args().write:
        VECTORS.write_text(text)
    elif VECTORS.read_text() != text:
        print(f"{VECTORS} differs from what this implementation computes", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
