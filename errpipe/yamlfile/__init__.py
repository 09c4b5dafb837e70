"""The only reader of YAML: version 1.2, every problem of a file at once, each with line and column.

    manifest = load(path, Manifest)                       # the validated model, or ConfigError
    document = read(path, environment=os.environ)         # values and places; ${NAME:-default} in texts
    pipeline = document.validate(Pipeline)

What 1.2 means here: `1e-3` is a number; `no`, `on`, `12:30` and `2024-01-01` are text; `010` is ten. Refused:
a key twice in one mapping, tags (`!!x`), several documents, aliases that blow up, nesting without end.
`${NAME}` and `${NAME:-default}` are replaced inside texts after parsing, so that a variable can never bring
in a key; the result stays text. `$${` stands for a literal `${`.

Quantities may have their unit: in a field whose `json_schema_extra` says `"unit": "um"`, the text `20 um` or
`0.02 mm` is converted; a bare number is in that unit already. Validation is strict, in JSON's sense: lists become
tuples and texts paths, but '5' is no number. (A `before` validator sees Python's sense instead; use `after`.)
"""

from errpipe.yamlfile.choice import Choice
from errpipe.yamlfile.document import MEASURED, Document, load, parse, read, text_of
from errpipe.yamlfile.events import plain
from errpipe.yamlfile.places import Place, describe, dotted
from errpipe.yamlfile.quantities import UNITS, InvalidKey, Options, convert, is_unit, quantity

__all__ = [
    "MEASURED",
    "UNITS",
    "Choice",
    "Document",
    "InvalidKey",
    "Options",
    "Place",
    "convert",
    "describe",
    "dotted",
    "is_unit",
    "load",
    "parse",
    "plain",
    "quantity",
    "read",
    "text_of",
]
