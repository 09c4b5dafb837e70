"""Code numbers in a compiled table and in the status of its cycle (`schemas/ect-2.md`)."""

# operations of nodes; flags of inputs, nodes and outputs; bits of the status
CONSTANT, INPUT, AFFINE, FIRST, LAG, PRODUCT, POWER, CLIP, SWITCH, DIRECTION, APPROACH, LOOKUP = range(1, 13)
OPTIONAL, FADE_ON_DEFAULT, HAS_VALID, HAS_MAX_RATE, HAS_STALE, HAS_HOLD = 1, 2, 4, 8, 16, 32
SLOW, START_ZERO = 1, 2
HAS_MAGNITUDE, HAS_SLEW, HAS_ACCELERATION = 1, 2, 4
RUNNING, ACTIVE, RAMPING, SUBSTITUTED, HELD, DEFAULTED, FADING, FADED = 1, 2, 4, 8, 16, 32, 64, 128
AT_MAGNITUDE, AT_RATE, BEYOND_PROFILE, WAITING, NOT_FINITE, HOLDING = 256, 512, 1024, 2048, 4096, 8192
LOST = 1 << 31  # internal: an input that matters is down to its default
PERIODIC = KEEP = 1
SLOW_KINDS = 4  # kinds of inputs from here on are shown in thermal cycles
OFF, ON, HOLD = 0, 1, 2  # modes of a cycle
LARGEST = 1e30  # as LARGEST_RESULT of domain/table.py
NOWHERE = 1e31  # value of an anchor before the first reading
