"""Signature files against readers and writers that are not errpipe's: the program minisign, and RFC 8032 by formula.

The layout is that of jedisct1.github.io/minisign, "Signature format": base64 of `ED`, 8 bytes of the key's number and
the signature of the file's BLAKE2b-512 hash; below it the signature of those 64 bytes and the trusted comment.
"""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path

import pytest

from errpipe.cli.app import main
from errpipe.errors import VerifyError
from errpipe.registry import minisign
from tests.unit.registry import ed25519

# Of the file `test` by the program minisign, as the README of minisign-verify 0.2 shows them: with and without a hash.
KEY_OF_THE_PROGRAM = "untrusted comment: x\nRWQf6LRCGA9i53mlYecO4IzT51TGPpvWucNSCh1CBM0QTaLn73Y7GFO3\n"
BY_THE_PROGRAM = {
    "prehashed": (
        "RUQf6LRCGA9i559r3g7V1qNyJDApGip8MfqcadIgT9CuhV3EMhHoN1mGTkUidF/z7SrlQgXdy8ofjb7bNJJylDOocrCo8KLzZwo=",
        "timestamp:1556193335\tfile:test",
        "y/rUw2y8/hOUYjZU71eHp/Wo1KZ40fGy2VJEDl34XMJM+TX48Ss/17u3IvIfbVR1FkZZSNCisQbuQY+bHwhEBg==",
    ),
    "legacy": (
        "RWQf6LRCGA9i59SLOFxz6NxvASXDJeRtuZykwQepbDEGt87ig1BNpWaVWuNrm73YiIiJbq71Wi+dP9eKL8OC351vwIasSSbXxwA=",
        "timestamp:1555779966\tfile:test",
        "QtKMXWyYcwdpZAlPF7tE2ENJkRd1ujvKjlj1m9RtHTBnZPa5WKU5uWRs5GoP5M/VqE81QFuMKI5k/SfNQUaOAA==",
    ),
}
SEED, NUMBER = bytes(range(32)), bytes(range(100, 108))


def test_the_formulas_are_those_of_rfc_8032() -> None:
    """Section 7.1, test 1: the empty message."""
    seed = bytes.fromhex("9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60")
    assert ed25519.public_key(seed).hex() == "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a"
    assert ed25519.sign(seed, b"").hex().startswith("e5564300c360ac729086e2cc806e828a84877f1eb8e5d974d873e06522490155")


@pytest.mark.parametrize("kind", BY_THE_PROGRAM)
@pytest.mark.parametrize("end", ["\n", "\r\n", ""])
def test_what_the_program_signed_verifies(tmp_path: Path, kind: str, end: str) -> None:
    (tmp_path / "k.pub").write_text(KEY_OF_THE_PROGRAM)
    key = minisign.read_public(tmp_path / "k.pub")
    own, comment, whole = BY_THE_PROGRAM[kind]
    text = (end or "\n").join(["untrusted comment: x", own, f"trusted comment: {comment}", whole]) + end
    assert key.name == "E7620F1842B4E81F"  # as the program prints it
    assert minisign.verify(b"test", text, key, "test") == comment
    with pytest.raises(VerifyError, match="was changed"):
        minisign.verify(b"Test", text, key, "test")
    with pytest.raises(VerifyError, match="was changed"):
        minisign.verify(b"test", text.replace("file:test", "file:rest"), key, "test")


def test_what_errpipe_signs_holds_by_the_formulas(tmp_path: Path) -> None:
    data = tmp_path / "table.ect"
    data.write_bytes(b"any bytes \0\xff" * 99)
    assert main(["keygen", str(tmp_path / "keys")]) == 0
    secret, public = tmp_path / "keys/errpipe.key", tmp_path / "keys/errpipe.pub"
    minisign.sign_file(data, minisign.read_secret(secret), "Maschine 7, März")
    key = base64.b64decode(public.read_text().splitlines()[1])
    _, own, comment, whole = (tmp_path / "table.ect.minisig").read_text(encoding="utf-8").splitlines()
    signature, comment = base64.b64decode(own), comment.removeprefix("trusted comment: ")
    assert (key[:2], signature[:2], signature[2:10]) == (b"Ed", b"ED", key[2:10])
    assert ed25519.holds(key[10:], hashlib.blake2b(data.read_bytes()).digest(), signature[10:])
    assert ed25519.holds(key[10:], signature[10:] + comment.encode(), base64.b64decode(whole))
    assert comment == "Maschine 7, März"
    stored = base64.b64decode(secret.read_text().splitlines()[1])
    assert ed25519.public_key(stored[62:94]) == stored[94:126] == key[10:]


def test_what_is_signed_by_the_formulas_verifies(tmp_path: Path) -> None:
    data = tmp_path / "table.ect"
    data.write_bytes(b"any bytes")

    def line(*parts: bytes) -> str:
        return base64.b64encode(b"".join(parts)).decode()

    (tmp_path / "k.pub").write_text(f"untrusted comment: x\n{line(b'Ed', NUMBER, ed25519.public_key(SEED))}\n")
    signature = ed25519.sign(SEED, hashlib.blake2b(b"any bytes").digest())
    whole = ed25519.sign(SEED, signature + b"by formula")
    text = f"untrusted comment: x\n{line(b'ED', NUMBER, signature)}\ntrusted comment: by formula\n{line(whole)}\n"
    (tmp_path / "table.ect.minisig").write_text(text)
    verify = ["verify-signature", str(data), "--public-key", str(tmp_path / "k.pub")]
    assert main(verify) == 0
    own = minisign.SecretKey(minisign.PublicKey(NUMBER, ed25519.public_key(SEED)), SEED)
    assert own.sign(b"any bytes", "by formula").splitlines()[1:] == text.splitlines()[1:]
    data.write_bytes(b"any bytez")
    assert main(verify) == 6
