"""`fit.json` belongs to the error model beside it: the fit of another model is refused, not validated for its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from errpipe import jsonfile
from errpipe.domain.error_model import ErrorModel
from errpipe.errors import VerifyError
from errpipe.formats import manifest_folder
from errpipe.models import FAMILIES
from errpipe.pipeline.stage import Context
from errpipe.stages import _artefacts
from errpipe.stages.validate import Validate
from tests.e2e.test_new_stage import recorded

OFFSET = {"components": [{"component": "EXX", "terms": [{"term": "offset"}]}]}


def test_validate_refuses_a_changed_model_with_the_fit_of_the_unchanged_one(tmp_path: Path) -> None:
    recorded(tmp_path / "in")
    recording = manifest_folder.read(tmp_path / "in")
    family = FAMILIES["terms"].model_validate(OFFSET)
    fit = Context(tmp_path / "fit")
    fit.folder.mkdir()
    _artefacts.write_model(fit, recording, family.fit(recording).model, family)
    folders = {"recording": {"in": tmp_path / "in"}, "error_model": {"fit": fit.folder}}
    (tmp_path / "out").mkdir()
    Validate(kind="validate").run(Context(tmp_path / "out", stages=folders))

    model = _artefacts.read_model(fit.folder / _artefacts.MODEL)
    halved = tuple(c.model_copy(update={"gain": 0.5 * c.gain}) for c in model.components)
    changed: ErrorModel = model.model_copy(update={"components": halved})
    jsonfile.write(fit.folder / _artefacts.MODEL, _artefacts.model_json(changed))
    with pytest.raises(VerifyError, match=r"fit\.json: is not the fit of the error_model\.json next to it"):
        Validate(kind="validate").run(Context(tmp_path / "out", stages=folders))

    document = jsonfile.read(fit.folder / _artefacts.PROCEDURE)
    jsonfile.write(fit.folder / _artefacts.PROCEDURE, {k: v for k, v in document.items() if k != "model"})
    Validate(kind="validate").run(Context(tmp_path / "out", stages=folders))  # a folder of an earlier version
