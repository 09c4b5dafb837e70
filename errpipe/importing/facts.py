"""Facts on the set-up stated in lines above a table."""

from __future__ import annotations

import re

FACTS = {
    "machine": r"machine|maschine",
    "serial_number": r"serial(?: ?(?:no|number))?|serien ?nr|seriennummer|s/n",
    "operator": r"operator|bediener|pr[üu]fer|inspector",
    "date": r"date|datum",
    "instrument": r"instrument|messger[äa]t|laser",
}
OF_A_FACT = "|".join(("axis|achse|axe|asse|eje|soft|program|title|titel|test|company|firma", *FACTS.values()))


def facts(above: list[str]) -> dict[str, str]:
    """Facts on the set-up from the lines above a table: `Maschine: VMC 3`."""
    found: dict[str, str] = {}
    for line in above:
        for name, words in FACTS.items():
            match = re.match(rf"\s*(?:{words})\b\.?\s*[:=;,]?\s+(\S.{{0,80}})$", line, re.IGNORECASE)
            if match and name not in found:
                found[name] = match.group(1).strip()
    return found
