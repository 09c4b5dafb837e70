"""Keys and signatures in minisign's file format: Ed25519 over the BLAKE2b-512 hash of a file (algorithm `ED`).

Whoever has the public key can check a signature with the program `minisign` and without errpipe. The secret key has
no password (as after `minisign -G -W`): it belongs into a secret store, and its file is readable by its owner only.
Source: jedisct1.github.io/minisign, section "signature format".
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import os
import stat
from dataclasses import dataclass
from pathlib import Path

from errpipe import files, jsonfile
from errpipe.errors import UsageError, VerifyError

ALGORITHM, PREHASHED, CHECKSUM, NO_PASSWORD = b"Ed", b"ED", b"B2", b"\0\0"
MAX_KEY_BYTES = 4096  # a key file has two lines
MAX_SIGNED_BYTES = 1 << 30  # tables have some kB, models some MB
SUFFIX = ".minisig"


@dataclass(frozen=True)
class PublicKey:
    """number: 8 bytes by which a signature names its key; key: 32 bytes."""

    number: bytes
    key: bytes

    @property
    def name(self) -> str:
        """The number as minisign prints it."""
        return self.number[::-1].hex().upper()

    def text(self) -> str:
        """The public key file."""
        return f"untrusted comment: minisign public key {self.name}\n{_base64(ALGORITHM + self.number + self.key)}\n"


@dataclass(frozen=True)
class SecretKey:
    """seed: 32 bytes."""

    public: PublicKey
    seed: bytes

    def text(self) -> str:
        """The secret key file, without a password."""
        secret = self.seed + self.public.key
        check = hashlib.blake2b(ALGORITHM + self.public.number + secret, digest_size=32).digest()
        head = ALGORITHM + NO_PASSWORD + CHECKSUM + bytes(32 + 8 + 8)
        line = _base64(head + self.public.number + secret + check)
        return f"untrusted comment: minisign secret key {self.public.name}\n{line}\n"

    def sign(self, data: bytes, trusted_comment: str) -> str:
        """The signature file of some bytes. The trusted comment is signed with them; it holds one line."""
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

        if not trusted_comment.isprintable():
            raise UsageError("a trusted comment is one line of printable characters")
        private = Ed25519PrivateKey.from_private_bytes(self.seed)
        signature = private.sign(hashlib.blake2b(data).digest())
        whole = private.sign(signature + trusted_comment.encode())
        line = _base64(PREHASHED + self.public.number + signature)
        head = f"untrusted comment: signature from errpipe secret key\n{line}\n"
        return f"{head}trusted comment: {trusted_comment}\n{_base64(whole)}\n"


def generate() -> SecretKey:
    """A new key pair."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    private = Ed25519PrivateKey.generate()
    return SecretKey(PublicKey(os.urandom(8), private.public_key().public_bytes_raw()), private.private_bytes_raw())


def write_pair(key: SecretKey, folder: Path) -> tuple[Path, Path]:
    """Write `errpipe.key` (secret, mode 0600) and `errpipe.pub`. Raises UsageError if one of them is there."""
    folder.mkdir(parents=True, exist_ok=True)
    secret, public = folder / "errpipe.key", folder / "errpipe.pub"
    for path in (secret, public):
        if path.exists() or path.is_symlink():
            raise UsageError(f"{path}: exists already (a key is never overwritten)")
    with os.fdopen(os.open(secret, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as stream:
        stream.write(key.text())
    jsonfile.write_text(public, key.public.text())
    return secret, public


def read_secret(path: Path) -> SecretKey:
    """A secret key file without a password, its owner's only. Raises VerifyError."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    data = _line(path, 158, "secret key")
    if stat.S_IMODE(path.stat().st_mode) & 0o077:
        raise VerifyError(f"{path}: others can read this secret key (allowed: chmod 600)")
    if data[:2] != ALGORITHM or data[4:6] != CHECKSUM:
        raise VerifyError(f"{path}: not a minisign secret key")
    if data[2:4] != NO_PASSWORD:
        raise VerifyError(f"{path}: has a password; errpipe signs with keys without one (minisign -C -W removes it)")
    number, secret, check = data[54:62], data[62:126], data[126:158]
    derived = Ed25519PrivateKey.from_private_bytes(secret[:32]).public_key().public_bytes_raw()
    expected = hashlib.blake2b(ALGORITHM + number + secret, digest_size=32).digest()
    if derived != secret[32:] or check not in (expected, bytes(32)):  # minisign leaves it zero without a password
        raise VerifyError(f"{path}: damaged secret key")
    return SecretKey(PublicKey(number, derived), secret[:32])


def read_public(path: Path) -> PublicKey:
    """A public key file. Raises VerifyError."""
    data = _line(path, 42, "public key")
    if data[:2] != ALGORITHM:
        raise VerifyError(f"{path}: not a minisign public key")
    return PublicKey(data[2:10], data[10:])


def verify(data: bytes, signature: str, key: PublicKey, shown: str) -> str:
    """The trusted comment. Raises VerifyError naming `shown` where the signature is not this key's for these bytes."""
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    lines = signature.split("\n")
    if len(lines) < 4 or not lines[2].startswith("trusted comment: "):
        raise VerifyError(f"{shown}: its signature is not one of minisign")
    own, whole = _decoded(lines[1], 74, f"{shown}: its signature"), _decoded(lines[3], 64, f"{shown}: its signature")
    if own[:2] not in (PREHASHED, ALGORITHM):
        raise VerifyError(f"{shown}: its signature is of an unknown kind")
    if own[2:10] != key.number:
        other = PublicKey(own[2:10], b"").name
        raise VerifyError(f"{shown}: signed by the key {other}, not by {key.name}")
    comment = lines[2].removeprefix("trusted comment: ").removesuffix("\r")
    public = Ed25519PublicKey.from_public_bytes(key.key)
    try:
        public.verify(own[10:], hashlib.blake2b(data).digest() if own[:2] == PREHASHED else data)
        public.verify(whole, own[10:] + comment.encode())
    except InvalidSignature:
        raise VerifyError(f"{shown}: was changed after it was signed, or the signature was") from None
    return comment


def sign_file(path: Path, key: SecretKey, trusted_comment: str) -> Path:
    """Write the signature beside a file."""
    data = files.read(path, MAX_SIGNED_BYTES, UsageError)
    jsonfile.write_text(signature_path(path), key.sign(data, trusted_comment))
    return signature_path(path)


def verify_file(path: Path, key: PublicKey) -> str:
    """The trusted comment of the signature beside a file. Raises VerifyError if there is none or it is wrong."""
    data = files.read(path, MAX_SIGNED_BYTES, VerifyError)
    return verify(data, signature_of(path), key, str(path))


def signature_path(path: Path) -> Path:
    """Where the signature of a file stands."""
    return path.with_name(path.name + SUFFIX)


def signature_of(path: Path, signature: Path | None = None) -> str:
    """The text of a file's signature (default: the one next to it). Raises VerifyError if there is none."""
    place = signature or signature_path(Path(path))
    if not place.exists():
        raise VerifyError(f"{path}: is not signed (no {place.name} beside it)")
    return _text(place)


def _text(path: Path) -> str:
    try:
        return files.read(path, MAX_KEY_BYTES, VerifyError).decode()
    except UnicodeDecodeError:
        raise VerifyError(f"{path}: not a text file of minisign") from None


def _line(path: Path, length: int, what: str) -> bytes:
    """The bytes of a key file's second line; the first is a comment."""
    lines = _text(path).split("\n")
    if len(lines) < 2:
        raise VerifyError(f"{path}: not a minisign {what}")
    return _decoded(lines[1], length, f"{path}: the {what}")


def _decoded(text: str, length: int, what: str) -> bytes:
    try:
        data = base64.b64decode(text.strip(), validate=True)
    except (binascii.Error, ValueError):
        data = b""
    if len(data) != length:
        raise VerifyError(f"{what} is damaged")
    return data


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
