"""Files that break one rule of the format page each: section, record, byte, what stands there instead.

Shared by the tests of all readers. `CASES` gives (what is wrong, bytes); every one is a sound file but for that.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

from errpipe.domain import table as t
from errpipe.tables import ect
from errpipe.tables import layout as lay

NAN, INF = float("nan"), float("inf")
# 1-based section numbers of the format page.
INPUT, SUBSTITUTE, NODE, OPERAND, LOOKUP, PROFILE, VALUE, COMPONENT, PAIR, OUTPUT, TERM = range(1, 12)


def sound() -> t.CompensationTable:
    """Every kind of record, every flag set somewhere and clear elsewhere."""
    nodes = (
        t.ConstantNode(value=1.0),
        t.InputNode(input="x"),
        t.InputNode(input="T", slow=True),
        t.AffineNode(of=(2,), offset=-20.0, weights=(1.0,), slow=True),
        t.FirstNode(of=(3,), slow=True),
        t.LagNode(of=(3,), tau_up=60.0, tau_down=90.0, start="zero", slow=True),
        t.LagNode(of=(1,), tau_up=0.1, tau_down=0.2),
        t.ProductNode(of=(3, 5), slow=True),
        t.PowerNode(of=(3,), exponent=2.0, slow=True),
        t.ClipNode(of=(3,), low=-5.0, high=5.0, slow=True),
        t.SwitchNode(of=(3,), on=1.0, off=0.5, slow=True),
        t.DirectionNode(of=(1,), threshold=0.01),
        t.ApproachNode(of=(1, 11), length=0.5, threshold=0.01),
        t.LookupNode(of=(3,), start=0.0, step=5.0, values=(0.0, 1.0, 3.0), slow=True),
        t.LookupNode(of=(1,), start=0.0, step=50.0, values=(1.0, 2.0)),
        t.LagNode(of=(1,), tau_up=1e-6, tau_down=1e-6),  # so short that nothing remains: factors of 0
    )
    return t.CompensationTable(
        machine="vmc ü",
        title="every kind",
        version="1",
        fingerprint="ab" * 32,
        position_cycle_s=0.001,
        slow_every=100,
        inputs=(
            t.TableInput(name="x", kind="position", axis="X", unit="mm", low=-10.0, high=510.0, default=0.0),
            t.TableInput(
                name="T",
                kind="sensor",
                unit="degC",
                low=-40.0,
                high=100.0,
                max_rate=2.0,
                noise=0.25,
                stale_after_s=5.0,
                substitute=(t.Substitute(input="U", weight=1.0),),
                substitute_offset=0.5,
                hold_s=60.0,
                default=20.0,
                valid=(15.0, 30.0),
                margin=5.0,
                fade_on_default=True,
            ),
            t.TableInput(name="U", kind="sensor", unit="degC", low=-40.0, high=100.0, default=20.0),
            t.TableInput(name="tool", kind="tool", unit="mm", low=0.0, high=300.0, default=0.0, optional=True),
        ),
        nodes=nodes,
        profiles=(
            t.Profile(input="x", start=0.0, step=100.0, values=(0, 1000, 2500, 4000, 8000, 10000, 9000)),
            t.Profile(values=(1000,)),
            t.Profile(input="x", start=0.0, step=2.5, values=(0, 700, 0, -700, 0), periodic=True),
        ),
        components=(t.Component(name="EXX"), t.Component(name="EBX", unit="urad")),
        pairs=(
            t.Pair(component="EXX", profile=0, driver=0),
            t.Pair(component="EXX", profile=1, driver=13, keep=True),
            t.Pair(component="EBX", profile=2, driver=7),
        ),
        outputs=(
            t.Output(
                name="X",
                axis="X",
                magnitude=100.0,
                slew=500.0,
                acceleration=5000.0,
                terms=(t.Monomial(weight=1.0, component="EXX"), t.Monomial(weight=1e-3, component="EBX", factors=(1,))),
            ),
            t.Output(
                name="B", axis="B", unit="urad", correction_unit="deg", terms=(t.Monomial(weight=1.0, component="EBX"),)
            ),
        ),
    )


# (what, section, record, byte of the record, struct format, value)
FIELDS: tuple[tuple[str, int, int, int, str, object], ...] = (
    ("input without a name", INPUT, 0, 0, "32s", b""),
    ("two inputs of one name", INPUT, 2, 0, "32s", b"T"),
    ("input name that fills its field", INPUT, 0, 0, "32s", b"x" * 32),
    ("input name that is not UTF-8", INPUT, 0, 0, "32s", b"\xff"),
    ("input name, overlong UTF-8", INPUT, 0, 0, "32s", b"\xc0\x80"),
    ("input name, half a surrogate", INPUT, 0, 0, "32s", b"\xed\xa0\x80"),
    ("input name, beyond Unicode", INPUT, 0, 0, "32s", b"\xf4\x90\x80\x80"),
    ("input name, cut within a letter", INPUT, 0, 0, "32s", b"\xe2\x82"),
    ("input name, bytes behind its end", INPUT, 0, 0, "32s", b"x\0y"),
    ("input name with a quote", INPUT, 0, 0, "32s", b'T"'),
    ("input name with a line end", INPUT, 0, 0, "32s", b"T\n"),
    ("input name that ends a comment", INPUT, 0, 0, "32s", b"T*/"),
    ("input name that is deleted", INPUT, 0, 0, "32s", b"T\x7f"),
    ("input's axis that is a path", INPUT, 0, 32, "8s", b"../x"),
    ("input's axis beyond ASCII", INPUT, 0, 32, "8s", b"\xc3\xa4"),
    ("input's unit with a star", INPUT, 0, 40, "16s", b"m*/"),
    ("axis that fills its field", INPUT, 0, 32, "8s", b"XXXXXXXX"),
    ("unit that fills its field", INPUT, 0, 40, "16s", b"m" * 16),
    ("kind 10", INPUT, 0, 56, "H", 10),
    ("unknown input flag", INPUT, 0, 58, "H", 64),
    ("list of substitutes that starts late", INPUT, 1, 60, "I", 1),
    ("list of substitutes too long", INPUT, 1, 64, "I", 2),
    ("substitute that nobody owns", INPUT, 1, 64, "I", 0),
    ("reserved field of an input", INPUT, 0, 68, "I", 1),
    ("low not a number", INPUT, 0, 72, "d", NAN),
    ("low too large", INPUT, 0, 72, "d", -1.1e15),
    ("high not above low", INPUT, 0, 80, "d", -10.0),
    ("high infinite", INPUT, 0, 80, "d", INF),
    ("max_rate without its flag", INPUT, 0, 88, "d", 1.0),
    ("noise without a max_rate", INPUT, 0, 152, "d", 1.0),
    ("noise below 0", INPUT, 1, 152, "d", -0.5),
    ("noise not a number", INPUT, 1, 152, "d", NAN),
    ("max_rate, minus zero without its flag", INPUT, 0, 88, "d", -0.0),
    ("max_rate of 0", INPUT, 1, 88, "d", 0.0),
    ("max_rate of 1e-15", INPUT, 1, 88, "d", 1e-15),
    ("stale_after without its flag", INPUT, 0, 96, "d", 1.0),
    ("stale_after negative", INPUT, 1, 96, "d", -1.0),
    ("hold without its flag", INPUT, 0, 104, "d", 1.0),
    ("hold negative", INPUT, 1, 104, "d", -1.0),
    ("hold a negative subnormal", INPUT, 1, 104, "d", -5e-324),
    ("hold not a number", INPUT, 1, 104, "d", NAN),
    ("default below low", INPUT, 0, 112, "d", -11.0),
    ("default above high", INPUT, 0, 112, "d", 511.0),
    ("default not a number", INPUT, 0, 112, "d", NAN),
    ("substitute's offset infinite", INPUT, 1, 120, "d", -INF),
    ("valid_low without its flag", INPUT, 0, 128, "d", 1.0),
    ("valid_high without its flag", INPUT, 0, 136, "d", 1.0),
    ("validity reversed", INPUT, 1, 136, "d", 14.0),
    ("validity not a number", INPUT, 1, 128, "d", NAN),
    ("margin without its flag", INPUT, 0, 144, "d", 1.0),
    ("margin of 0", INPUT, 1, 144, "d", 0.0),
    ("substitute of an input that is not there", SUBSTITUTE, 0, 0, "I", 4),
    ("substitute of itself", SUBSTITUTE, 0, 0, "I", 1),
    ("substitute that is optional", SUBSTITUTE, 0, 0, "I", 3),
    ("reserved field of a substitute", SUBSTITUTE, 0, 4, "I", 1),
    ("substitute's weight not a number", SUBSTITUTE, 0, 8, "d", NAN),
    ("operation 0", NODE, 0, 0, "H", 0),
    ("operation 13", NODE, 0, 0, "H", 13),
    ("unknown node flag", NODE, 0, 2, "H", 4),
    ("starts at zero, but no lag", NODE, 0, 2, "H", 2),
    ("list of operands that starts late", NODE, 3, 4, "I", 1),
    ("affine without operands", NODE, 3, 8, "I", 0),
    ("input with an operand", NODE, 1, 8, "I", 1),
    ("first with two operands", NODE, 4, 8, "I", 2),
    ("approach with one operand", NODE, 12, 8, "I", 1),
    ("input that is not there", NODE, 1, 12, "I", 4),
    ("affine with an input", NODE, 3, 12, "I", 1),
    ("constant with lookup values", NODE, 0, 16, "I", 1),
    ("reserved field of a node", NODE, 0, 20, "I", 1),
    ("constant too large", NODE, 0, 24, "d", 1.1e15),
    ("constant not a number", NODE, 0, 24, "d", NAN),
    ("constant with a second number", NODE, 0, 32, "d", 1.0),
    ("input with a number", NODE, 1, 24, "d", 1.0),
    ("offset infinite", NODE, 3, 24, "d", INF),
    ("affine with a second number", NODE, 3, 32, "d", 1.0),
    ("first with a number", NODE, 4, 24, "d", 1.0),
    ("tau_up of 0", NODE, 5, 24, "d", 0.0),
    ("tau_up that is not the factor's", NODE, 5, 24, "d", 61.0),
    ("tau_down negative", NODE, 5, 32, "d", -90.0),
    ("lag factor of a slow node, last bit", NODE, 5, 40, "bits", 1),
    ("lag factor of a fast node, last bit", NODE, 6, 48, "bits", 1),
    ("lag factor, minus zero", NODE, 15, 40, "d", -0.0),
    ("lag factor falling, minus zero", NODE, 15, 48, "d", -0.0),
    ("lag factor, a negative subnormal", NODE, 15, 40, "d", -5e-324),
    ("lag factor falling, negative and too small for single precision", NODE, 15, 48, "d", -1e-100),
    ("product with a number", NODE, 7, 24, "d", 1.0),
    ("exponent of 0", NODE, 8, 24, "d", 0.0),
    ("exponent above 16", NODE, 8, 24, "d", 16.1),
    ("exponent not a number", NODE, 8, 24, "d", NAN),
    ("power with a second number", NODE, 8, 32, "d", 1.0),
    ("clip reversed", NODE, 9, 32, "d", -6.0),
    ("clip not a number", NODE, 9, 24, "d", NAN),
    ("clip with a third number", NODE, 9, 40, "d", 1.0),
    ("switch off above on", NODE, 10, 32, "d", 2.0),
    ("switch not a number", NODE, 10, 24, "d", NAN),
    ("threshold negative", NODE, 11, 24, "d", -0.01),
    ("threshold too large", NODE, 11, 24, "d", 1.1e15),
    ("start neither -1 nor 1", NODE, 11, 32, "d", 0.5),
    ("start of 0", NODE, 11, 32, "d", 0.0),
    ("approach of length 0", NODE, 12, 24, "d", 0.0),
    ("approach with a threshold below 0", NODE, 12, 32, "d", -0.01),
    ("approach with a threshold too large", NODE, 12, 32, "d", 1.1e15),
    ("approach with a third number", NODE, 12, 40, "d", 1.0),
    ("lookup values that start late", NODE, 14, 12, "I", 2),
    ("lookup with one value", NODE, 14, 16, "I", 1),
    ("lookup with too many values", NODE, 14, 16, "I", 3),
    ("lookup step negative", NODE, 13, 32, "d", -5.0),
    ("lookup start not a number", NODE, 13, 24, "d", NAN),
    ("reciprocal of a lookup's step, last bit", NODE, 13, 40, "bits", 1),
    ("reciprocal of another lookup's step", NODE, 13, 40, "d", 1e30),
    ("lookup with a fourth number", NODE, 13, 48, "d", 1.0),
    ("operand that is the node itself", OPERAND, 0, 0, "I", 3),
    ("operand far away", OPERAND, 0, 0, "I", 0xFFFFFFFF),
    ("reserved field of an operand", OPERAND, 0, 4, "I", 1),
    ("affine weight not a number", OPERAND, 0, 8, "d", NAN),
    ("weight of an operand that is not of an affine", OPERAND, 1, 8, "d", 2.0),
    ("lookup value not a number", LOOKUP, 1, 0, "d", NAN),
    ("lookup value too large", LOOKUP, 1, 0, "d", 1e16),
    ("profile over an input that is not there", PROFILE, 0, 0, "i", 4),
    ("profile over input -2", PROFILE, 0, 0, "i", -2),
    ("curve without an input", PROFILE, 0, 0, "i", -1),
    ("constant with an input", PROFILE, 1, 0, "i", 0),
    ("unknown profile flag", PROFILE, 0, 4, "I", 2),
    ("periodic profile that does not end as it began", PROFILE, 0, 4, "I", 1),
    ("profile values that start late", PROFILE, 1, 8, "I", 8),
    ("profile without values", PROFILE, 1, 12, "I", 0),
    ("profile with too many values", PROFILE, 2, 12, "I", 6),
    ("profile start not a number", PROFILE, 0, 16, "d", NAN),
    ("profile step of 0", PROFILE, 0, 24, "d", 0.0),
    ("reciprocal of a profile's step, last bit", PROFILE, 0, 32, "bits", 1),
    ("reciprocal of a profile's turn, last bit", PROFILE, 2, 40, "bits", 1),
    ("reciprocal of another profile's step", PROFILE, 0, 32, "d", 1e30),
    ("reciprocal of a profile's step, infinite", PROFILE, 0, 32, "d", INF),
    ("reciprocal of a profile's step, not a number", PROFILE, 0, 32, "d", NAN),
    ("reciprocal of a profile's step, negative", PROFILE, 0, 32, "d", -1.0),
    ("reciprocal of a profile's step in a thousandth part", PROFILE, 2, 32, "d", 1.001),
    ("reciprocal of another profile's turn", PROFILE, 2, 40, "d", 1e30),
    ("turn of a profile that has none", PROFILE, 0, 40, "d", 0.2),
    ("turn of a profile that has none, minus zero", PROFILE, 0, 40, "d", -0.0),
    ("scale of 0", PROFILE, 0, 48, "d", 0.0),
    ("scale not a number", PROFILE, 0, 48, "d", NAN),
    ("interpolation error negative", PROFILE, 0, 56, "d", -1e-9),
    ("interpolation error infinite", PROFILE, 0, 56, "d", INF),
    ("rounding error not a number", PROFILE, 0, 64, "d", NAN),
    ("rounding error, negative subnormal", PROFILE, 0, 64, "d", -5e-324),
    ("profile value 2^30", VALUE, 1, 0, "i", 1 << 30),
    ("profile value -2^30", VALUE, 1, 0, "i", -(1 << 30)),
    ("periodic profile with another last value", VALUE, 12, 0, "i", 1),
    ("component without a name", COMPONENT, 0, 0, "16s", b""),
    ("two components of one name", COMPONENT, 1, 0, "16s", b"EXX"),
    ("component name that is not UTF-8", COMPONENT, 0, 0, "16s", b"\x80"),
    ("component name with a semicolon", COMPONENT, 0, 0, "16s", b"EXX;"),
    ("component unit 2", COMPONENT, 0, 16, "I", 2),
    ("reserved field of a component", COMPONENT, 0, 20, "I", 1),
    ("pair of a component that is not there", PAIR, 0, 0, "I", 2),
    ("pair of a profile that is not there", PAIR, 0, 4, "I", 3),
    ("pair of a node that is not there", PAIR, 0, 8, "I", 16),
    ("unknown pair flag", PAIR, 0, 12, "I", 2),
    ("output without a name", OUTPUT, 0, 0, "32s", b""),
    ("two outputs of one name", OUTPUT, 1, 0, "32s", b"X"),
    ("output name with a bracket", OUTPUT, 0, 0, "32s", b"X{"),
    ("output's axis that is a path", OUTPUT, 0, 32, "8s", b"X/"),
    ("output's axis with bytes behind its end", OUTPUT, 0, 32, "8s", b"X\0Y"),
    ("um as deg", OUTPUT, 0, 40, "I", 0x300),
    ("correction unit 5", OUTPUT, 0, 40, "I", 0x500),
    ("unit with bits above", OUTPUT, 0, 40, "I", 0x10000),
    ("unknown output flag", OUTPUT, 0, 44, "I", 8),
    ("list of terms that starts late", OUTPUT, 1, 48, "I", 1),
    ("output without terms", OUTPUT, 1, 52, "I", 0),
    ("output with too many terms", OUTPUT, 1, 52, "I", 2),
    ("factor of another unit", OUTPUT, 0, 56, "d", 1.0),
    ("factor, last bit", OUTPUT, 1, 56, "bits", 1),
    ("magnitude without its flag", OUTPUT, 1, 64, "d", 1.0),
    ("magnitude of 0", OUTPUT, 0, 64, "d", 0.0),
    ("slew without its flag", OUTPUT, 1, 72, "d", 1.0),
    ("slew negative", OUTPUT, 0, 72, "d", -500.0),
    ("acceleration without its flag", OUTPUT, 1, 80, "d", 1.0),
    ("acceleration not a number", OUTPUT, 0, 80, "d", NAN),
    ("term of a component that is not there", TERM, 0, 0, "I", 2),
    ("term with five factors", TERM, 0, 4, "I", 5),
    ("factor that is not there", TERM, 1, 8, "I", 16),
    ("unused factor that is not FFFFFFFF", TERM, 0, 8, "I", 0),
    ("weight infinite", TERM, 0, 24, "d", INF),
)
# (what, byte of the file, struct format, value)
HEADER: tuple[tuple[str, int, str, object], ...] = (
    ("magic", 0, "8s", b"ECU\0\r\n\x1a\n"),
    ("text mode", 0, "8s", b"ECT\0\n\x1a\n\0"),
    ("format version 3", 8, "I", 3),
    ("format version 1 with the records of version 2", 8, "I", 1),
    ("header size 256", 12, "I", 256),
    ("file size too small", 16, "I", 512),
    ("slow_every of 0", 24, "I", 0),
    ("slow_every of 1000001", 24, "I", 1_000_001),
    ("reserved field of the header", 28, "I", 1),
    ("position cycle of 0", 32, "d", 0.0),
    ("position cycle too long", 32, "d", 10.1),
    ("position cycle not a number", 32, "d", NAN),
    ("thermal cycle that is not the product", 40, "d", 0.2),
    ("ramp negative", 48, "d", -1.0),
    ("ramp too long", 48, "d", 3601.0),
    ("ramp not a number", 48, "d", NAN),
    ("fade negative", 56, "d", -1.0),
    ("fade infinite", 56, "d", INF),
    ("machine that fills its field", 64, "64s", b"m" * 64),
    ("title that is not UTF-8", 128, "128s", b"\xc3"),
    ("title with a line end", 128, "128s", b"a\nb"),
    ("machine with a carriage return", 64, "64s", b"a\rb"),
    ("version with an escape", 256, "32s", b"\x1b"),
    ("version with bytes behind its end", 256, "32s", b"1\0" + b"1"),
    ("reserved end of the header", 500, "I", 1),
    ("section with another id", 320, "I", 2),
    ("section with another record size", 324, "I", 168),
    ("section with one record less", 328, "I", 3),
    ("section with too many records", 328, "I", 65),
    ("section at another place", 332, "I", 520),
    ("no nodes", 320 + 32 + 8, "I", 0),
)


def mended(data: bytes | bytearray) -> bytes:
    """The bytes with the checksum that belongs to them."""
    out = bytearray(data)
    struct.pack_into("<I", out, 20, zlib.crc32(out[24:]))
    return bytes(out)


def _changed(data: bytes, at: int, form: str, value: object) -> bytes:
    out = bytearray(data)
    if form == "bits":
        (bits,) = struct.unpack_from("<Q", out, at)
        struct.pack_into("<Q", out, at, bits ^ int(str(value)))
    else:
        struct.pack_into("<" + form, out, at, value)
    assert out != data, (at, form, value)
    return mended(out)


def cases() -> Iterator[tuple[str, bytes]]:
    """(what is wrong, bytes) of every refused file."""
    data = ect.dumps(sound())
    starts = {n: struct.unpack_from("<I", data, 320 + 16 * (n - 1) + 12)[0] for n in lay.RECORDS}
    for what, at, form, value in HEADER:
        yield what, _changed(data, at, form, value)
    for what, section, record, at, form, value in FIELDS:
        yield what, _changed(data, starts[section] + record * lay.RECORDS[section][1].size + at, form, value)
    yield "approach of version 1 with a threshold", ect.dumps(sound().model_copy(update={"table": 1}))
    x, *others = sound().inputs
    far = x.model_copy(update={"valid": (0.0, 1e14), "margin": 1.0})
    yield "validity 1e13 periods away", ect.dumps(sound().model_copy(update={"inputs": (far, *others)}))
    yield "no end", data[:-8]
    yield "bytes behind the end", mended(data[:16] + struct.pack("<I", len(data) + 8) + data[20:] + bytes(8))
    yield "gap behind the profile values", _changed(data, starts[COMPONENT] - 4, "I", 1)  # an odd number of them
    broken = bytearray(data)
    broken[20] ^= 1
    yield "checksum", bytes(broken)


CASES = tuple(cases())
