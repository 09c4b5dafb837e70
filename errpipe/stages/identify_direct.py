"""From laser and level records to all components, as an identification and as an error model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from errpipe import jsonfile, yamlfile
from errpipe.domain.components import is_error_motion
from errpipe.errors import DataError
from errpipe.pipeline.stage import Context, Need
from errpipe.stages import _artefacts
from errpipe.stages.identify import IDENTIFICATION, Identify


class IdentifyDirect(Identify):
    """Identify components measured singly by laser and level in both directions, with errors of the beam corrected.

    Writes what `identify` writes, for `export_volumetric`; and an error model of the components in the last recording
    before it, for `validate`, `export`, `report` and `errpipe predict`.
    """

    kind: Literal["identify_direct"]  # type: ignore[assignment]  # a stage of its own kind, with the same options
    takes: ClassVar[Mapping[str, Need]] = Identify.takes
    gives: ClassVar[tuple[str, ...]] = ("identified_machine", "error_model")

    def outputs(self) -> tuple[str, ...]:
        return (*super().outputs(), _artefacts.MODEL, _artefacts.PROCEDURE)

    def run(self, context: Context) -> Mapping[str, Any]:
        from errpipe.domain.machine import Machine
        from errpipe.kinematics import direct_model, records
        from errpipe.kinematics.chain import compile_chain
        from errpipe.models.direct import Direct

        tests = _artefacts.recordings_in(context)
        for name, recording in tests.items():
            if not records.is_direct(recording):
                raise DataError(f"{self.label}: {name} holds no error motion such as EXX or EBX; `identify` reads it")
        out = super().run(context)
        *_, last = tests.values()
        motions = [c for c in last.components() if is_error_motion(c)]
        document = jsonfile.read(context.folder / IDENTIFICATION)
        machine: Machine = yamlfile.load(self.machine, Machine)
        model = direct_model.error_model(compile_chain(machine), last, document, document["noise_of"])
        model = _artefacts.with_sign_note(model) if document.get("sign") == "assumed" else model
        family = Direct(
            machine=machine,
            modes=document["procedure"]["modes"],
            components=tuple(motions),
            lasers={n: laser for n, laser in self.lasers.items() if n in motions},
        )
        _artefacts.write_model(context, last, model, family)
        return out
