"""What errpipe depends on, directly and through others, as installed: for the lock file and for the licences.

python -m tests.contract.dependencies > requirements.lock
"""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

ROOT = Path(__file__).parents[2]


def canonical(name: str) -> str:
    """A distribution's name as it is compared."""
    return re.sub(r"[-_.]+", "-", name).lower()


def declared() -> dict[str, list[str]]:
    """Requirements of pyproject.toml: "" for those always needed, else by extra."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return {"": project["dependencies"], **project["optional-dependencies"]}


def name_of(requirement: str) -> str:
    """The name at the start of a requirement."""
    return canonical(re.match(r"[A-Za-z0-9._-]+", requirement)[0])  # type: ignore[index]


def closure(requirements: list[str]) -> dict[str, Distribution]:
    """Every installed distribution that these requirements lead to, by name. Markers of other systems are left out."""
    from packaging.requirements import Requirement

    by_name: dict[str, Distribution] = {}
    waiting = [(Requirement(text), "") for text in requirements]
    seen = set()
    while waiting:
        requirement, extra = waiting.pop()
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        key = (canonical(requirement.name), tuple(sorted(requirement.extras)))
        if key in seen:
            continue
        seen.add(key)
        try:
            by_name[key[0]] = distribution(requirement.name)
        except PackageNotFoundError:
            continue
        needs = [Requirement(text) for text in by_name[key[0]].requires or []]
        waiting += [(need, e) for need in needs for e in ("", *requirement.extras)]
    return by_name


def licence(found: Distribution) -> str:
    """What a distribution says of its licence: expression, classifiers, first line of the text, in this order."""
    meta = found.metadata
    classifiers = [c.split("::")[-1].strip() for c in meta.get_all("Classifier") or [] if c.startswith("License ::")]
    classifiers = [c for c in classifiers if c != "OSI Approved"]
    text = (meta.get("License") or "").strip().splitlines()
    return meta.get("License-Expression") or " / ".join(classifiers) or (text[0] if text else "")


if __name__ == "__main__":
    everything = closure([text for group in declared().values() for text in group])
    print("# Versions that the tests ran with (`make lock`). In CI: pip install -c requirements.lock -e '.[dev]'")
    for name, found in sorted(everything.items()):
        print(f"{name}=={found.version}")
