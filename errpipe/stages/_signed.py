"""`signed: required` of an export: the table's signature is made or checked before anything else is written."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field, ValidationInfo, field_validator

from errpipe import jsonfile
from errpipe.errors import VerifyError
from errpipe.pipeline.stage import InputPath
from errpipe.yamlfile import Options

if TYPE_CHECKING:
    from errpipe.domain.table import CompensationTable

KEY_VARIABLE = "ERRPIPE_KEY"  # names the file of the secret key, as for `errpipe sign`


class SignOptions(Options):
    """Whether a table may leave without a signature."""

    signed: Literal["required", "optional"] = Field(
        "optional",
        description="required: the table is signed with the secret key that ERRPIPE_KEY names, or `signature` must be "
        "that of this very table; else nothing is exported.",
    )
    public_key: InputPath | None = Field(
        None, description="Public key that verifies the signature, such as errpipe.pub.", validate_default=True
    )
    signature: InputPath | None = Field(
        None, description="Signature made elsewhere (`errpipe sign`) of the table that this pipeline exports."
    )

    @field_validator("public_key")
    @classmethod
    def _key_where_required(cls, value: Path | None, info: ValidationInfo) -> Path | None:
        if value is None and info.data.get("signed") == "required":
            raise ValueError("`signed: required` needs it")
        return value

    def write_signature(self, table: CompensationTable, path: Path) -> tuple[str, ...]:
        """Write the signature next to the table's file; returns remarks for controllers' files, () if none is required.

        Raises VerifyError if there is no signature, or it is not of this table by this key.
        """
        if self.signed != "required" or self.public_key is None:
            return ()
        from errpipe.registry import minisign, signed
        from errpipe.stages.signing import sign

        key, signature_file = minisign.read_public(self.public_key), minisign.signature_path(path)
        secret = os.environ.get(KEY_VARIABLE)
        if self.signature is not None:
            jsonfile.write_text(signature_file, minisign.signature_of(path, self.signature))
        elif secret:
            sign(path, Path(secret), "")
        else:
            raise VerifyError(
                f"export: the table is not signed: {KEY_VARIABLE} names no secret key, and there is no `signature:` "
                "(a person signs what `--set export.signed=optional` exports, with `errpipe sign`)"
            )
        if signed.read_table(path, key) != table:
            raise VerifyError(f"export: {path.name} is not the table that was compiled")
        return signed.remarks(table, signature_file.read_text(encoding="utf-8"), key)
