"""Names of implausible declarations, and the text of `errpipe explain NAME` for each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

EXPLANATIONS: dict[str, str] = {
    "absolute-readings": (
        "The error column changes with the position at a rate near +1 or -1 (or at the ratio of two units). "
        "Deviation is actual minus commanded: subtract the commanded position, both in one unit."
    ),
    "as-large-as-travel": (
        "The error column spans more than 3 % of the travel. Columns are swapped, the error is in um but "
        "declared as mm, or the position is in m or inch but declared as mm."
    ),
    "beyond-limit": (
        "The correction is larger than `export: {limit: ...}`; by default 0.5 mm or 1/1000 of the travel, "
        "whichever is more (1 mm/m for angles). A machine with such an error needs its screw pitch or steps "
        "per mm corrected first."
    ),
    "constant-deviation": (
        "Every reading of the error column is the same number, or one precise reading is repeated in many rows. "
        "It is another column, a value that was filled in, or the instrument did not log."
    ),
    "copy-of-column": (
        "The error column is another column times a constant, row for row, or one run repeats another to the last "
        "digit (a file imported twice). It contains no independent measurement."
    ),
    "direction-not-of-motion": (
        "The axis sweeps up and down, but the direction column does not follow it. It is +1 when the position rises."
    ),
    "expands-too-much": (
        "The slope of the deviation grows by more than 60 um/m for each kelvin of every temperature; aluminium has 23. "
        "The error or the temperature is in another unit, or another sensor is meant."
    ),
    "exchanged-sensors": (
        "From one run on two temperatures are exchanged, as earlier runs show: their plugs were exchanged. "
        "Exchange the readings back, or give both columns the role ignore."
    ),
    "jump": (
        "The error steps by exactly 1 mm, 0.1 inch or 1 inch between neighbours: a dial gauge went through a "
        "full turn that was not counted."
    ),
    "mirrored-rows": (
        "Both directions agree only when the readings of one are taken in the opposite order: the return pass was "
        "written in the order of the targets, the positions in the order of the measurement."
    ),
    "mixed-sign": "One run or one direction holds the curve of the others with the other sign.",
    "mixed-units": (
        "One run or one direction holds the same curve, or the same targets, 25.4 or 1000 times larger than the others."
    ),
    "new-zero": (
        "From one run to the next, or within a run, every target shifts by one amount, several times what runs differ "
        "by otherwise: the instrument was zeroed again, or the axis was homed. Subtract the shift from the readings "
        "from there on, or leave out the runs before or after it. Splitting the run there does not help: it leaves two "
        "zeros, and no term separates them from the parts of the machine that are not measured yet."
    ),
    "not-a-temperature": "A temperature column follows the position back and forth within every run.",
    "other-zero": (
        "The deviation has one large value everywhere and hardly varies: the readings are counted from another zero "
        "than the positions. Subtract the reading at the reference position, or set both to zero there."
    ),
    "outside-travel": (
        "Positions leave the travel of the manifest, or cover so little of it that their unit must be another one."
    ),
    "reversal-sign": (
        "Approached from below the axis stops further than from above. Lost motion does the opposite; check "
        "the sign of the error and of the direction."
    ),
    "reversed-direction": (
        "The direction column is +1 when the position decreases. It must be +1 for an approach from below."
    ),
    "reversed-sign": "The error column is commanded minus actual. Deviation is actual minus commanded.",
    "run-per-row": ("The run column has a new label in every row. Held-out validation would leave out single rows."),
    "shifted-rows": (
        "The two directions agree much better when each deviation is moved to the neighbouring target: the "
        "column is shifted by one row. Two F tests show it, with fewer than one false alarm in 1000 recordings."
    ),
    "shrinks-when-warm": (
        "The slope of the deviation falls by 5 to 26 um/m for each kelvin of every temperature. Scales and "
        "screws get longer when warm, so the sign is reversed."
    ),
    "shuffled-rows": (
        "One run jumps from target to target and does not have the shape of the others, which are smooth and alike: "
        "its rows are in another order than its positions, or its measurement failed."
    ),
    "temperature-jump": (
        "A temperature steps by more than 15 K from one row of a run to the next and comes back as suddenly. A sensor "
        "without power reads 85 degC or 0 degC; clean the recording, or give the column the role ignore."
    ),
    "temperature-range": (
        "A temperature lies outside -30 to 150 degC, or follows another one as degF does, or is degC only when "
        "read as degF: then it is as cold as the other sensors when they are cold. Declare its unit (degC, degF, K)."
    ),
    "too-fast": "Half of all steps are faster than 10 m/s (100 rev/s). Time or position is in another unit.",
    "too-small": (
        "No deviation exceeds 0.05 um, or 1 ppm of the travel with readings quieter than a laser in air. Readings in "
        "mm were declared as um."
    ),
    "worse-with-compensation": (
        "Rows with the compensation on (a column of role group, of: compensation, labels on and off) are more "
        "wrong than those with it off, or as wrong the other way round. The sign is reversed, or the error that was "
        "compensated is twice the true one (a radius beside a diameter, a double pass of a laser)."
    ),
    "wrong-axis": "The component belongs to an axis that does not move, or whose position is not recorded.",
}

if TYPE_CHECKING:
    Code = str
else:
    Code = Literal[tuple(EXPLANATIONS)]  # what `allow` of a pipeline takes, in its schema too
