"""Units of parameters as powers of m, s, N, K and rad, so that any spelling of a compatible unit can be compared."""

from __future__ import annotations

import re
from collections import Counter

# factor, dimension
ATOMS: dict[str, tuple[float, str]] = {
    "nm": (1e-9, "m"),
    "um": (1e-6, "m"),
    "µm": (1e-6, "m"),
    "μm": (1e-6, "m"),
    "mm": (1e-3, "m"),
    "m": (1.0, "m"),
    "ms": (1e-3, "s"),
    "s": (1.0, "s"),
    "min": (60.0, "s"),
    "h": (3600.0, "s"),
    "d": (86400.0, "s"),
    "N": (1.0, "N"),
    "kN": (1e3, "N"),
    "K": (1.0, "K"),
    "degC": (1.0, "K"),
    "mK": (1e-3, "K"),
    "urad": (1e-6, "rad"),
    "mrad": (1e-3, "rad"),
    "rad": (1.0, "rad"),
    "arcsec": (4.84813681e-6, "rad"),
    "deg": (0.01745329252, "rad"),
    "ppm": (1e-6, ""),
    "1": (1.0, ""),
    "1e-6": (1e-6, ""),
    "hPa": (1e2, "Pa"),
    "Pa": (1.0, "Pa"),
    "kg": (1.0, "kg"),
    "rpm": (1.0, "rpm"),
}
TOKEN = re.compile(r"\(|\)|/|1e-6|[A-Za-zµμ]+|[²³]|\^?-?\d+|[*·\s]+")


def parse(text: str) -> tuple[float, tuple[tuple[str, int], ...]] | None:
    """Factor to SI and the powers of the dimensions; None where a word is unknown."""
    pieces = [p for p in TOKEN.findall(text.strip()) if p.strip(" *·\t")]
    if "".join(pieces) != re.sub(r"[*·\s]", "", text):
        return None
    factor, powers = 1.0, Counter()
    sign, stack, i = 1, [], 0
    while i < len(pieces):
        piece = pieces[i]
        i += 1
        if piece == "/":
            sign = -(stack[-1] if stack else 1)
            continue
        if piece == "(":
            stack.append(sign)
            continue
        if piece == ")":
            if not stack:
                return None
            stack.pop()
            sign = stack[-1] if stack else 1
            continue
        if piece not in ATOMS:
            return None
        power = 1
        if i < len(pieces) and re.fullmatch(r"[²³]|\^?-?\d+", pieces[i]):
            power = {"²": 2, "³": 3}.get(pieces[i]) or int(pieces[i].lstrip("^"))
            i += 1
        scale, dimension = ATOMS[piece]
        factor *= scale ** (sign * power)
        if dimension:
            powers[dimension] += sign * power
    return factor, tuple(sorted((k, v) for k, v in powers.items() if v))


def ratio(unit: str, wanted: str) -> float | None:
    """How many `wanted` one `unit` is; None where they are not compatible."""
    if unit == wanted:
        return 1.0
    if "1" in (unit, wanted):  # a plain number (an exponent, a gain) is no slope in um/m, though both have no dimension
        return None
    a, b = parse(unit), parse(wanted)
    if a is None or b is None or a[1] != b[1]:
        return None
    return a[0] / b[0]
