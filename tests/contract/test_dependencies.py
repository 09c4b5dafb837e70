"""Every dependency is used, locked, and under a licence that fits; docs/dependencies.md lists them."""

from __future__ import annotations

import re

import pytest

from tests.contract.dependencies import ROOT, canonical, closure, declared, licence, name_of
from tests.contract.test_layers import imports, modules

# Where the name that is imported is not the name that is installed.
IMPORTED = {
    "scikit-learn": "sklearn",
    "ruamel-yaml": "ruamel",
    "nptdms": "nptdms",
    "python-calamine": "python_calamine",
}
FREE = r"MIT|BSD|Apache|PSF|Python Software Foundation|ISC|Zlib|HPND|CC0|0BSD|MPL|Mozilla|Unlicense|Public Domain"
# Told by hand where the metadata does not say: distribution -> where the licence stands.
BY_HAND = {"fmpy": "BSD-2-Clause (LICENSE of the distribution)"}
# Weaker duties than errpipe's users may expect: only in an extra that someone asks for, or to test with.
NOT_IN_THE_CORE = {"nptdms": "LGPL-3.0-only, extra tdms", "blark": "GPL-2.0, tests only"}


def licence_of(name: str, found) -> str:
    return BY_HAND.get(name) or licence(found)


@pytest.mark.parametrize("extra", [group for group in declared() if group != "dev"])
def test_every_dependency_is_imported(extra: str) -> None:
    used = {name.split(".")[0] for module, path in modules() for _, name in imports(path.read_text(), module)}
    idle = [n for n in map(name_of, declared()[extra]) if IMPORTED.get(n, n.replace("-", "_")) not in used]
    assert idle == [], f"nothing imports {idle}"


def test_the_core_is_under_permissive_licences() -> None:
    core = closure(declared()[""])
    assert len(core) > 15
    wrong = {name: licence_of(name, match) for name, match in core.items()}
    wrong = {name: text for name, text in wrong.items() if not re.search(FREE, text) or "GPL" in text}
    assert wrong == {} and not NOT_IN_THE_CORE.keys() & core.keys()


def test_everything_else_is_free_or_known() -> None:
    everything = closure([text for group in declared().values() for text in group])
    texts = {name: licence_of(name, match) for name, match in everything.items() if name not in NOT_IN_THE_CORE}
    assert {name: text for name, text in texts.items() if not re.search(FREE, text)} == {}


def test_the_page_lists_every_direct_dependency_and_its_licence() -> None:
    page = (ROOT / "docs" / "dependencies.md").read_text()
    rows = {canonical(cells[0]): cells[1] for cells in re.findall(r"^\| ([\w.-]+) \| ([^|]+) \|", page, re.M)}
    direct = {name_of(text) for group in declared().values() for text in group}
    assert direct - rows.keys() == set() and rows.keys() - direct - {"name", "-"} == set()


def test_the_lock_holds_every_dependency_at_a_version_that_fits() -> None:
    from packaging.requirements import Requirement

    lock = (ROOT / "requirements.lock").read_text()
    pinned = dict(re.findall(r"^([a-z0-9-]+)==(\S+)$", lock, re.M))
    assert "://" not in lock and "@" not in lock
    for group in declared().values():
        for text in group:
            requirement = Requirement(text)
            name = canonical(requirement.name)
            assert name in pinned, f"{name} is not locked: make lock"
            assert requirement.specifier.contains(pinned[name], prereleases=True), f"{name} {pinned[name]}"
