"""Records of the binary compensation table, `.ect` versions 1 and 2: `schemas/ect-2.md` describes every field."""

from __future__ import annotations

import struct

from errpipe.domain import table as t

MAGIC = b"ECT\x00\r\n\x1a\n"  # a transfer in text mode damages it
VERSIONS = (1, 2)  # of the format, oldest first
HEADER = struct.Struct("<8sIIIII4xdddd")  # magic, version, header size, file size, crc, slow_every, cycles, ramp, fade
HEADER_SIZE = 512
CRC_FROM = 24  # the checksum covers everything after itself
IDENTITY_AT = 64
IDENTITY = struct.Struct("<64s128s32s32s")  # machine, title, version, fingerprint
SECTIONS_AT = IDENTITY_AT + IDENTITY.size
SECTION = struct.Struct("<IIII")  # id, record size, count, offset

INPUT = struct.Struct("<32s8s16sHHII4x" + "11d")
INPUT_1 = struct.Struct("<32s8s16sHHII4x" + "10d")  # of version 1: without noise
SUBSTITUTE = struct.Struct("<I4xd")
NODE = struct.Struct("<HHIIII4x" + "4d")
OPERAND = struct.Struct("<I4xd")
REAL = struct.Struct("<d")
PROFILE = struct.Struct("<iIII" + "7d")
VALUE = struct.Struct("<i")
COMPONENT = struct.Struct("<16sI4x")
PAIR = struct.Struct("<IIII")
OUTPUT = struct.Struct("<32s8sIIII" + "4d")
TERM = struct.Struct("<II4Id")

RECORDS = {
    1: ("inputs", INPUT),
    2: ("substitutes", SUBSTITUTE),
    3: ("nodes", NODE),
    4: ("operands", OPERAND),
    5: ("lookup values", REAL),
    6: ("profiles", PROFILE),
    7: ("profile values", VALUE),
    8: ("components", COMPONENT),
    9: ("pairs", PAIR),
    10: ("outputs", OUTPUT),
    11: ("terms", TERM),
}
RECORDS_1 = RECORDS | {1: ("inputs", INPUT_1)}
_MAX_RECORDS = (
    *(t.MAX_INPUTS, t.MAX_OPERANDS, t.MAX_NODES, t.MAX_OPERANDS, t.MAX_LOOKUP_VALUES, t.MAX_PROFILES, t.MAX_VALUES),
    *(t.MAX_COMPONENTS, t.MAX_PAIRS, t.MAX_OUTPUTS, t.MAX_MONOMIALS),
)
MAX_RECORDS = dict(zip(RECORDS, _MAX_RECORDS, strict=True))  # records of a section

KINDS = ("position", "direction", "velocity", "force", "sensor", "speed", "coolant", "load", "tool", "other")
UNITS = ("um", "urad")
CORRECTION_UNITS = ("mm", "um", "urad", "deg", "rad")
NONE = 0xFFFFFFFF  # number of an absent input, node or profile

# Input flags, node flags, profile flags, pair flags.
OPTIONAL, FADE_ON_DEFAULT, HAS_VALID, HAS_MAX_RATE, HAS_STALE, HAS_HOLD = 1, 2, 4, 8, 16, 32
SLOW, START_ZERO = 1, 2
PERIODIC = 1
KEEP = 1
# Output flags
HAS_MAGNITUDE, HAS_SLEW, HAS_ACCELERATION = 1, 2, 4

# Operation -> (code, class, parameters in the order of the record).
OPERATIONS: dict[str, tuple[int, type[t.Node], tuple[str, ...]]] = {
    "constant": (1, t.ConstantNode, ("value",)),
    "input": (2, t.InputNode, ()),
    "affine": (3, t.AffineNode, ("offset",)),
    "first": (4, t.FirstNode, ()),
    "lag": (5, t.LagNode, ("tau_up", "tau_down")),
    "product": (6, t.ProductNode, ()),
    "power": (7, t.PowerNode, ("exponent",)),
    "clip": (8, t.ClipNode, ("low", "high")),
    "switch": (9, t.SwitchNode, ("on", "off")),
    "direction": (10, t.DirectionNode, ("threshold", "start")),
    "approach": (11, t.ApproachNode, ("length", "threshold")),
    "lookup": (12, t.LookupNode, ("start", "step")),
}
BY_CODE = {code: (op, cls, fields) for op, (code, cls, fields) in OPERATIONS.items()}


def records(version: int) -> dict[int, tuple[str, struct.Struct]]:
    """Section id -> its name and record, of a format version."""
    return RECORDS_1 if version == 1 else RECORDS


def input_flags(i: t.TableInput) -> int:
    """The flags of an input's record."""
    has = {HAS_VALID: i.valid, HAS_MAX_RATE: i.max_rate, HAS_STALE: i.stale_after_s, HAS_HOLD: i.hold_s}
    flags = OPTIONAL * i.optional | FADE_ON_DEFAULT * i.fade_on_default
    return flags | sum(flag for flag, value in has.items() if value is not None)
