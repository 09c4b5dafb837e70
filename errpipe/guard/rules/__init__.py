"""Rules of the sensor guard: tests of each reading by itself. A new one is one file here and one entry in RULES."""

from __future__ import annotations

from typing import TYPE_CHECKING

from errpipe.guard.rules._base import FALSE_ALARMS, Rule, activity, activity_of
from errpipe.yamlfile import Choice

NAMES = ("frozen_reading", "sudden_change")
RULES: Choice[type[Rule]] = Choice.of_files("errpipe.guard.rules", "rule", NAMES)

__all__ = ["FALSE_ALARMS", "RULES", "AnyRule", "Rule", "activity", "activity_of"]

if TYPE_CHECKING:
    AnyRule = Rule
else:
    AnyRule = RULES
