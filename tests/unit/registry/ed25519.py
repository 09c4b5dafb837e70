"""Ed25519 from its formulas (RFC 8032, section 5.1), for the tests: slow, and nothing of `cryptography` in it."""

from __future__ import annotations

import hashlib

P = 2**255 - 19
ORDER = 2**252 + 27742317777372353535851937790883648493
D = -121665 * pow(121666, -1, P) % P
Point = tuple[int, int]


def add(a: Point, b: Point) -> Point:
    """Sum of two points of the curve -x2 + y2 = 1 + d x2 y2."""
    (x1, y1), (x2, y2) = a, b
    product = D * x1 * x2 * y1 * y2
    x = (x1 * y2 + x2 * y1) * pow(1 + product, -1, P)
    return x % P, (y1 * y2 + x1 * x2) * pow(1 - product, -1, P) % P


def times(n: int, point: Point) -> Point:
    """n times a point."""
    out = (0, 1)
    while n:
        if n & 1:
            out = add(out, point)
        point, n = add(point, point), n >> 1
    return out


def from_y(y: int, odd: int) -> Point:
    """The point of a y and the lowest bit of its x. Raises ValueError where there is none."""
    square = (y * y - 1) * pow(D * y * y + 1, -1, P) % P
    x = pow(square, (P + 3) // 8, P)
    if (x * x - square) % P:
        x = x * pow(2, (P - 1) // 4, P) % P
    if (x * x - square) % P:
        raise ValueError("no point of the curve")
    return (x if x & 1 == odd else P - x), y


BASE = from_y(4 * pow(5, -1, P) % P, 0)


def written(point: Point) -> bytes:
    """32 bytes of a point."""
    return (point[1] | (point[0] & 1) << 255).to_bytes(32, "little")


def read(data: bytes) -> Point:
    """The point of 32 bytes."""
    number = int.from_bytes(data, "little")
    return from_y(number & (2**255 - 1), number >> 255)


def number(*parts: bytes) -> int:
    """SHA-512 of some bytes as a number."""
    return int.from_bytes(hashlib.sha512(b"".join(parts)).digest(), "little")


def secret(seed: bytes) -> tuple[int, bytes]:
    """The secret number of a seed of 32 bytes, and what is mixed into its signatures."""
    digest = hashlib.sha512(seed).digest()
    low = int.from_bytes(digest[:32], "little")
    return (low & (2**254 - 8)) | 2**254, digest[32:]


def public_key(seed: bytes) -> bytes:
    """The public key of a seed."""
    return written(times(secret(seed)[0], BASE))


def sign(seed: bytes, message: bytes) -> bytes:
    """64 bytes."""
    own, mixed = secret(seed)
    r = number(mixed, message) % ORDER
    point = written(times(r, BASE))
    return point + ((r + number(point, public_key(seed), message) * own) % ORDER).to_bytes(32, "little")


def holds(key: bytes, message: bytes, signature: bytes) -> bool:
    """Whether a signature is the key's for a message."""
    s = int.from_bytes(signature[32:], "little")
    turned = add(read(signature[:32]), times(number(signature[:32], key, message) % ORDER, read(key)))
    return s < ORDER and times(s, BASE) == turned
