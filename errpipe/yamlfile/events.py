"""From the parser's events to plain values and their places.

Built here from events, and not by the library's constructor, because a duplicate key must not hide the
problems after it, an alias must not multiply without end, and a scalar must mean what YAML 1.2 says.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any, NoReturn

from errpipe.errors import ConfigError, Problem, did_you_mean
from errpipe.yamlfile.places import Location, Place, dotted

# Far above what anyone writes by hand and far below what hurts.
MAX_DEPTH = 40
MAX_NODES = 200_000  # aliases followed, so that a few lines cannot expand to billions of nodes
MAX_TEXT = 100_000  # characters of one scalar

_NULL = re.compile(r"(?:null|Null|NULL|~|)\Z")
_BOOL = re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z")
_INT = re.compile(r"[-+]?[0-9]{1,18}\Z|0o[0-7]{1,20}\Z|0x[0-9a-fA-F]{1,15}\Z")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?\Z")
_SPECIAL = re.compile(r"(?:([-+]?)\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))\Z")
_VARIABLE = re.compile(r"\$\$\{|\$\{([A-Za-z_][A-Za-z0-9_]*)(?::-([^{}]*))?\}|\$\{")
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f]")  # all but tab and line feed; "\\0" in quotes would bring them in
_SURROGATE = re.compile("[\ud800-\udfff]")


def plain(text: str) -> Any:
    """The value of an unquoted scalar by the core schema of YAML 1.2 (section 10.3.2)."""
    if _NULL.match(text):
        return None
    if _BOOL.match(text):
        return text[0] in "tT"
    if _INT.match(text):
        return int(text, 0) if text[:2] in ("0o", "0x") else int(text)
    if _FLOAT.match(text):
        return float(text)
    special = _SPECIAL.match(text)
    if special is None:
        return text
    return math.nan if special[1] is None else -math.inf if special[1] == "-" else math.inf


class _Stop(Exception):
    """The rest of the text cannot be made sense of."""


class Builder:
    """Turns one text into a value; notes lesser problems in `problems`, places in `spots`."""

    def __init__(self, file: str, environment: Mapping[str, str] | None):
        self.file = file
        self.environment = environment
        self.locations: dict[Place, Location] = {}
        self.problems: list[Problem] = []
        self._events: Iterator[Any] = iter(())
        self._anchors: dict[str, Any] = {}
        self._open: set[str] = set()
        self._nodes = 0

    def build(self, text: str) -> Any:
        """The value of the text. Raises ConfigError if it cannot be parsed to its end."""
        from ruamel.yaml import YAML
        from ruamel.yaml.error import MarkedYAMLError, YAMLError
        from ruamel.yaml.reader import ReaderError

        try:
            self._events = iter(YAML(typ="safe", pure=True).parse(text))
            return self._top()
        except _Stop:
            pass
        except MarkedYAMLError as err:
            what = ", ".join(part.split("\n")[0] for part in (err.problem, err.context) if part)
            if "'\\t'" in what:
                what = "a tab is not allowed here (indent with spaces)"
            mark, start = err.problem_mark or err.context_mark, err.context_mark
            if start is not None and start.line != mark.line:
                what += f" that starts in line {start.line + 1}"
            self._note(mark, (), f"not YAML: {what}")
        except ReaderError as err:
            line, column = text.count("\n", 0, err.position) + 1, err.position - text.rfind("\n", 0, err.position)
            what = f"not YAML: the character U+{ord(text[err.position]):04X} is not allowed"
            self.problems.append(Problem(self.file, line, column, "", what))
        except (YAMLError, ValueError, OverflowError) as err:
            self.problems.append(Problem(self.file, 0, 0, "", f"not YAML: {str(err).splitlines()[0]}"))
        raise ConfigError(list(dict.fromkeys(self.problems)))

    def _top(self) -> Any:
        value, documents = None, 0
        for event in self._events:
            kind = type(event).__name__
            if kind == "DocumentStartEvent":
                documents += 1
                if documents > 1:
                    self._stop(event, (), "a second document starts here (one is allowed)")
                if event.version is not None and tuple(event.version) != (1, 2):
                    self._stop(event, (), f"asks for YAML {'.'.join(map(str, event.version))} (1.2 is read)")
            elif kind in ("ScalarEvent", "SequenceStartEvent", "MappingStartEvent", "AliasEvent"):
                value = self._value(event, (), None, 0)
        if value is None:
            self.problems.append(Problem(self.file, 1, 1, "", "the file is empty"))
            raise _Stop
        return value

    def _value(self, event: Any, place: Place, key: Any, depth: int) -> Any:
        self._count(event, place, 1)
        if depth > MAX_DEPTH:
            self._stop(event, (), f"nested more than {MAX_DEPTH} levels deep")
        self.locations[place] = Location(_spot(event.start_mark), _spot(key.start_mark) if key is not None else None)
        kind = type(event).__name__
        if kind == "AliasEvent":
            return self._alias(event, place)
        if event.tag is not None:
            self._note(event.start_mark, place, f"has the tag {event.tag} (tags are not read)")
        if event.anchor:
            self._open.add(event.anchor)
        if kind == "ScalarEvent":
            value = self._scalar(event, place)
        elif kind == "SequenceStartEvent":
            value = self._list(place, depth)
        else:
            value = self._mapping(place, depth)
        if event.anchor:
            self._open.discard(event.anchor)
            self._anchors[event.anchor] = value
        return value

    def _alias(self, event: Any, place: Place) -> Any:
        name = event.anchor
        if name in self._open:
            self._stop(event, place, f"the alias *{name} is inside its own anchor")
        if name not in self._anchors:
            self._stop(event, place, f"the alias *{name} names nothing above.{did_you_mean(name, self._anchors)}")
        value = self._anchors[name]
        self._count(event, place, _size(value))
        return _copy(value)

    def _list(self, place: Place, depth: int) -> list[Any]:
        items: list[Any] = []
        for event in self._events:
            if type(event).__name__ == "SequenceEndEvent":
                break
            items.append(self._value(event, (*place, len(items)), None, depth + 1))
        return items

    def _mapping(self, place: Place, depth: int) -> dict[str, Any]:
        mapping: dict[str, Any] = {}
        for key in self._events:
            kind = type(key).__name__
            if kind == "MappingEndEvent":
                break
            if kind != "ScalarEvent":
                self._stop(key, place, "a key is a list, a mapping or an alias (a text is needed)")
            name = key.value
            if name in mapping:
                first = (self.locations[(*place, name)].key or (0, 0))[0]
                self._note(key.start_mark, (*place, name), f"duplicate key in one mapping (first in line {first})")
                self._value(next(self._events), (*place, f"{name} again"), key, depth + 1)
            else:
                mapping[name] = None  # so that its own place is known while its value is read
                mapping[name] = self._value(next(self._events), (*place, name), key, depth + 1)
        return mapping

    def _scalar(self, event: Any, place: Place) -> Any:
        text = event.value
        if len(text) > MAX_TEXT:
            self._stop(event, place, f"a text of {len(text)} characters (at most {MAX_TEXT} are read)")
        if _SURROGATE.search(text):
            self._note(event.start_mark, place, "half of a surrogate pair is not a character")
            return ""
        control = _CONTROL.search(text)
        if control:
            self._note(event.start_mark, place, f"holds the control character U+{ord(control[0]):04X}")
            return ""
        value = text if event.style else plain(text)
        if isinstance(value, str) and self.environment is not None and "$" in value:
            return _VARIABLE.sub(lambda match: self._variable(match, event, place), value)
        return value

    def _variable(self, match: re.Match[str], event: Any, place: Place) -> str:
        name, default = match[1], match[2]
        if match[0] == "$${":
            return "${"
        if name is None:
            self._note(event.start_mark, place, "'${' is not followed by NAME} or NAME:-default}")
            return ""
        value = (self.environment or {}).get(name)
        if value is None and default is None:
            what = f"the environment variable {name} is not set (${{{name}:-default}} would do without)"
            self._note(event.start_mark, place, what)
        return value or default or ""

    def _count(self, event: Any, place: Place, more: int) -> None:
        self._nodes += more
        if self._nodes > MAX_NODES:
            self._stop(event, place, f"the file holds more than {MAX_NODES} values (aliases followed)")

    def _note(self, mark: Any, place: Place, message: str) -> None:
        self.problems.append(Problem(self.file, *_spot(mark), dotted(place), message))

    def _stop(self, event: Any, place: Place, message: str) -> NoReturn:
        self._note(event.start_mark, place, message)
        raise _Stop


def _spot(mark: Any) -> tuple[int, int]:
    return (mark.line + 1, mark.column + 1) if mark is not None else (0, 0)


def _size(value: Any) -> int:
    if isinstance(value, dict):
        return 1 + sum(map(_size, value.values()))
    return 1 + sum(map(_size, value)) if isinstance(value, list) else 1


def _copy(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _copy(part) for key, part in value.items()}
    return [_copy(part) for part in value] if isinstance(value, list) else value
