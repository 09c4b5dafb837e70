"""errpipe from Python: read, fit, diagnose, and tables to call; the same code as the command line (docs/python.md).

    import errpipe
    recording = errpipe.read("recording")                        # a folder, or a vendor's file
    model = errpipe.fit(recording, {"EXX": [{"term": "offset"}, {"term": "scale_error", "axis": "X"}]})
    table = errpipe.Table.of(model)
    table.deviation({"x": [0.0, 300.0, 600.0]})                  # um
    cycle = table.cycle()                                        # for your own Numba code

Deviation is actual minus commanded; what a controller adds is minus that. Units: mm, deg, s, degC, um, urad.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

    from errpipe.domain.diagnosis import Diagnosis
    from errpipe.domain.error_model import ErrorModel
    from errpipe.domain.recording import Recording
    from errpipe.domain.table import CompensationTable


def read(path: str | Path, format: str | None = None, **options: Any) -> Recording:
    """A recording folder or a vendor's file, whole, in canonical units; `.frame` is its pandas table.

    Raises ConfigError (manifest), DataError (rows), UsageError (format).
    """
    from errpipe import formats

    return formats.read(Path(path), format, options)


def recording(frame: pd.DataFrame, columns: Mapping[str, Mapping[str, Any]], **facts: Any) -> Recording:
    """A recording from a pandas table. columns: name -> its manifest entry, such as {"role": "position", "axis": "X",
    "unit": "mm"}; columns of the table that are not named are left out. facts: title, machine, constants.

    Values are converted to canonical units. Raises ValueError for an entry that does not fit.
    """
    import numpy as np

    from errpipe.domain import units
    from errpipe.domain.recording import Recording
    from errpipe.domain.written_manifest import WrittenManifest
    from errpipe.formats import manifest_folder

    manifest = WrittenManifest.model_validate({"recording": 1, "tables": ("memory.csv",), "columns": columns, **facts})
    out = {}
    for name, c in manifest.columns.items():
        if c.role == "ignore":
            continue
        if c.role in ("run", "group"):
            out[name] = frame[name].astype(str)
            continue
        values, convert = frame[name].to_numpy(dtype=float), units.conversion(c.role, c.unit)
        out[name] = np.asarray(values if convert is None else convert(values))
    import pandas as pd

    return Recording(manifest_folder.canonical(manifest), pd.DataFrame(out).reset_index(drop=True))


def fit(recording: Recording, components: Mapping[str, Sequence[Mapping[str, Any]]], **options: Any) -> ErrorModel:
    """Fit terms (`errpipe terms`) to components: {"EXX": [{"term": "backlash", "axis": "X"}]}.

    options: as of the stage `fit` (method, holdout, selection, ...). Parameters come with 95 % intervals.
    Raises DataError for a missing column, NotIdentifiable where the rows cannot distinguish parameters.
    """
    from errpipe.fitting import model
    from errpipe.fitting.spec import ModelSpec

    listed = [{"component": name, "terms": list(terms)} for name, terms in components.items()]
    return model.fit(recording, ModelSpec.model_validate({"components": listed, **options}))


def predict(model: ErrorModel, recording: Recording) -> pd.DataFrame:
    """The model's deviation on every row, one column per component, um or urad, shape (rows, components)."""
    import pandas as pd

    from errpipe.fitting.components import evaluate

    return pd.DataFrame(dict(evaluate(model, recording)))


def diagnose(recording: Recording) -> Diagnosis:
    """What the simulated columns leave out of the error columns: located, named, with parameters and confidence.

    Raises DataError if no response has both.
    """
    from errpipe.diagnosis import diagnose as judge

    diagnosis, _ = judge(recording, lambda share, text: None)
    return diagnosis


def findings(recording: Recording) -> list[str]:
    """Everything implausible about what a recording declares (sign, unit, columns, axes), in words."""
    from errpipe.validation import plausibility

    return [str(f) for f in plausibility.findings(recording)]


@dataclass(frozen=True)
class Cycle:
    """A table for the caller's own Numba code: `step(program, state, readings, fresh, dt, False, ON)` is one cycle.

    step: njit function; program: read only; state: changed by every cycle; ON: the mode in which corrections act.
    After a step `state.outputs[o].correction` is what the controller adds, in the output's correction unit, and
    `state.outputs[o].deviation` is the deviation, um (urad). inputs, outputs: names in the order of the readings and
    of the outputs. identity: the name by which a controller shows the table.

    A step is a cycle of a controller, as long as the table says whatever dt is: another place for one step alone
    counts as a bad sample where the axis stands. True in place of False, with dt the time since the row before: rows
    of a recording, each of which is accepted.
    """

    step: Any
    program: Any
    state: Any
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    ON: int
    identity: str


@dataclass(frozen=True)
class Table:
    """A compensation table, as a controller runs it."""

    table: CompensationTable

    @classmethod
    def of(cls, model: ErrorModel, **options: Any) -> Table:
        """A fitted model compiled. options: as of the stage `export` (error_bound in um, position_cycle in s, ...)."""
        from errpipe.stages.export import Export, compile_model

        return cls(compile_model(model, Export.model_validate({"kind": "export", **options})))

    @classmethod
    def read(cls, path: str | Path, public_key: str | Path | None = None) -> Table:
        """A `.ect` file or its JSON twin. public_key: a file; the table must be signed by it.

        Raises VerifyError if the table is damaged, or is not signed by that key.
        """
        from errpipe.tables import ect

        if public_key is not None:
            from errpipe.registry import minisign, signed

            return cls(signed.read_table(Path(path), minisign.read_public(Path(public_key))))

        return cls(ect.read_either(Path(path)))

    @property
    def identity(self) -> str:
        """The name by which a controller shows this table: 8 hexadecimal digits (`crc` of the C runtime)."""
        from errpipe.tables import ect

        return ect.fingerprint(self.table)

    def write(self, path: str | Path) -> None:
        """Write the binary `.ect` file."""
        from errpipe.tables import ect

        ect.write(self.table, Path(path))

    def deviation(self, inputs: Mapping[str, Any] | pd.DataFrame) -> pd.DataFrame:
        """Deviations in settled states, one row per row of `inputs`, um or urad by output name.

        inputs: name -> values, shape (n,) or one value for all; an input that is not named is at its default.
        Raises DataError for a name that the table does not have.
        """
        import numpy as np
        import pandas as pd

        from errpipe.errors import DataError, did_you_mean
        from errpipe.tables import batch

        known = [i.name for i in self.table.inputs]
        for name in inputs:
            if name not in known:
                near = did_you_mean(str(name), known)
                raise DataError(f"the table has no input {name!r} (inputs: {', '.join(known)}).{near}")
        moving = tuple(inputs)
        points = np.column_stack(np.broadcast_arrays(*(np.atleast_1d(np.asarray(inputs[n], float)) for n in moving)))
        values = batch.position(self.table, np.ascontiguousarray(points), moving)
        return pd.DataFrame(values, columns=[o.name for o in self.table.outputs])

    def replay(self, recording: Recording) -> pd.DataFrame:
        """Deviations on a recording as the controller would have had them: row k uses rows up to k of its run."""
        import pandas as pd

        from errpipe.domain.error_model import ErrorModel
        from errpipe.stages.predict import table_values

        return pd.DataFrame(dict(table_values(self.table, ErrorModel(components=()), recording)))

    def cycle(self, unlimited: bool = False) -> Cycle:
        """Function, program and a fresh state for the caller's own njit loop.

        unlimited: also of a table with an output without magnitude or slew, or beyond 10 mm (10 mrad) or as much in a
        second, as no export has that does not state it; a VerifyError otherwise, as of `ect_load` in C.
        """
        from errpipe.errors import VerifyError
        from errpipe.kernels import table_codes, table_cycle
        from errpipe.tables import limits, pack

        if not unlimited and (wide := limits.without_limits(self.table)):
            raise VerifyError(
                f"{wide} is corrected without magnitude or slew, or beyond 10 mm or 10 mm/s (allow it: unlimited=True)"
            )

        program = pack.program(self.table)
        names = tuple(i.name for i in self.table.inputs)
        outputs = tuple(o.name for o in self.table.outputs)
        # Once another kernel was compiled, the module holds the dispatcher itself in place of the kernel.
        function = getattr(table_cycle.cycle, "compiled", table_cycle.cycle)
        return Cycle(function, program, pack.state(program), names, outputs, table_codes.ON, self.identity)

    def plot(self) -> str:
        """The correction of the first axes as text, for a terminal."""
        import tempfile

        from errpipe.verbs.show import show

        with tempfile.TemporaryDirectory() as folder:
            self.write(Path(folder) / "table.ect")
            return "\n".join(show(Path(folder) / "table.ect")["says"])
