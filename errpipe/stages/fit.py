"""A model family fitted to a recording: an error model, and the procedure that validation repeats."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, ClassVar, Literal

from pydantic import create_model

from errpipe.errors import MissingColumn
from errpipe.models import BY_FIT, DEFAULT, FAMILIES, SEVERAL, Family
from errpipe.pipeline.stage import Context, Need, Stage
from errpipe.stages import _artefacts
from errpipe.yamlfile import Choice


class FitStage(Stage):
    """Fit a model family on all rows of the recording."""

    kind: Literal["fit"]
    takes: ClassVar[Mapping[str, Need]] = {"recording": Need("recording")}
    gives: ClassVar[tuple[str, ...]] = ("error_model",)
    variant_key: ClassVar[str] = "family"
    default_variant: ClassVar[str] = DEFAULT
    of: ClassVar[type[Family]]

    def outputs(self) -> tuple[str, ...]:
        return (_artefacts.MODEL, _artefacts.PROCEDURE, *self.of.documents)

    def run(self, context: Context) -> Mapping[str, Any]:
        folder, family = context.needed("recording"), self.family_options()
        source = _artefacts.source_in(folder)
        context.progress(0.1, "fitting")
        if source is not None and family.in_batches(source):
            recording, fitted = source.ends, family.fit_batches(source)
        else:
            recording = _artefacts.recording_in(folder)
            try:
                fitted = family.fit(recording, context.progress)
            except MissingColumn as missing:
                raise _artefacts.with_cleaning_reason(folder, missing) from missing
        _artefacts.write_model(context, recording, fitted.model, family)
        for name, document in fitted.documents.items():
            context.write_json(name, document)
        return dict(fitted.summary)

    def family_options(self) -> Family:
        """What to fit, without what only the stage needs."""
        return self.of(**{name: getattr(self, name) for name in self.of.model_fields})


def _stage_of(name: str) -> type[FitStage]:
    """The stage of one family: its options and those of every stage."""
    family: Any = FAMILIES[name]
    title: Any = f"Fit{family.__name__}"
    made = create_model(title, __base__=(family, FitStage), __module__=__name__, __doc__=family.__doc__)
    stage: Any = made
    stage.of = family
    return stage


Fit: Choice[type[FitStage]] = Choice(
    FitStage.variant_key,
    {name: partial(_stage_of, name) for name in BY_FIT},
    FitStage.default_variant,
    several=(SEVERAL, "among"),
)
