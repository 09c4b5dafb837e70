"""What is never set or read: parameters that every call leaves alone or gives the same value, options that nothing
states, fields of dataclasses that no code reads.

A call counts wherever it stands: package, tests, trials, examples, code of the documentation. A function that is also
handed on as a value is left out, since its calls cannot be followed; so is a method that several classes define.
"""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pytest

from errpipe.cleaning import RULES
from errpipe.formats import FORMATS
from errpipe.models import FAMILIES
from errpipe.stages import STAGES
from errpipe.targets import TARGETS
from tests.contract.sources import parsed

ROOT = Path(__file__).parents[2]
CALLERS = ("errpipe", "tests", "trials", "bench", "examples")
GENERATED = ("formats.md", "recordings.md", "stages.md", "targets.md", "terms.md")
PUBLIC = ("api", "cli")  # called by users of the package, and by the command line
CONSTANT = re.compile(r"-?[\d.]+(e-?\d+)?|'.*'|True|False|None")
KNOWN = {  # parameter -> why it may stay
    "diagnosis.prepare._long(least)": "named beside its caller's threshold",
    "formats.ecmc_dat.read(options)": "passed by way of the registry",
    "thermal.arithmetic.slope(low)": "the lower of two bounds",
}
KNOWN_OPTIONS = {  # option -> who sets it
    "models.terms.less_simulated": "the diagnosis, for the model that it writes",
    "stages.fit.less_simulated": "the same option, named by a pipeline that repeats this fit",
}

KNOWN_FIELDS = {  # field of a dataclass -> who reads it
    "simulation.ball_screw_axis.Simulated.truth": "the trials and tests that judge a correction of the simulated axis",
    "tables.reference.Cycle.faults": "whoever compares an evaluator with the reference",
    "validation.input_drift.Drift.healthy": "the pages of a retraining, from its document",
    "validation.outlying_runs.OutlyingRun.wrong": "the gates of a retraining, from its document",
}


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[1:] if parts[0] == "errpipe" else parts).removesuffix(".__init__")


def imported(nodes: Sequence[ast.AST]) -> dict[str, str]:
    """Local name -> module of errpipe, or `module.name` in it. nodes: of a module."""
    out = {}
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("errpipe"):
            of = str(node.module).removeprefix("errpipe").lstrip(".")
            out |= {a.asname or a.name: f"{of}.{a.name}".lstrip(".") for a in node.names}
    return out


def named(node: ast.expr, own: str, names: Mapping[str, str], defined: Mapping[str, int]) -> str:
    """`module.function` that an expression names where that is one of those defined, else `.name`."""
    match node:
        case ast.Name(id=name):
            full = names.get(name, f"{own}.{name}")
        case ast.Attribute(value=ast.Name(id=of), attr=name):
            full = f"{names.get(of, '')}.{name}"
        case ast.Attribute(attr=name):
            full = ""
        case _:
            return ""
    return full if full in defined else f".{full.split('.')[-1] or name}"


def parameters(tree: ast.Module, module: str) -> Iterator[tuple[str, int, ast.arg, bool]]:
    """(function or .method, place, parameter, whether it has a default) of all functions of a module."""
    for top in tree.body:
        for f in top.body if isinstance(top, ast.ClassDef) else [top]:
            if not isinstance(f, ast.FunctionDef) or f.name.startswith("__"):
                continue
            static = not isinstance(top, ast.ClassDef) or any(
                ast.unparse(d) == "staticmethod" for d in f.decorator_list
            )
            key = f"{module}.{f.name}" if top is f else f".{f.name}"
            placed = [*f.args.posonlyargs, *f.args.args][0 if static else 1 :]
            for n, argument in enumerate(placed):
                yield key, n, argument, n >= len(placed) - len(f.args.defaults)
            for argument, default in zip(f.args.kwonlyargs, f.args.kw_defaults, strict=True):
                yield key, 10_000, argument, default is not None


def given(call: ast.Call, place: int, name: str) -> str:
    """What a call gives a parameter, as text: `` where it leaves it out, `?` where that cannot be seen."""
    if any(isinstance(a, ast.Starred) for a in call.args) or any(k.arg is None for k in call.keywords):
        return "?"
    values = [k.value for k in call.keywords if k.arg == name] or call.args[place : place + 1]
    return ast.unparse(values[0]) if values else ""


def unset(trees: Mapping[str, ast.Module], callers: Mapping[str, ast.Module]) -> set[str]:
    """`function(parameter)` that no call sets, or that every call of two or more gives the same constant."""
    defined = Counter(key for module, tree in trees.items() for key in {k for k, *_ in parameters(tree, module)})
    calls: dict[str, list[ast.Call]] = defaultdict(list)
    values = set()  # handed on without being called
    for own, tree in {**callers, **trees}.items():
        # one walk of a tree: most nodes are contexts, constants and statements, which name nothing
        nodes = [n for n in ast.walk(tree) if isinstance(n, ast.Call | ast.Name | ast.Attribute | ast.ImportFrom)]
        names = imported(nodes)
        called = {id(n.func) for n in nodes if isinstance(n, ast.Call)}
        for node in nodes:
            if isinstance(node, ast.Call):
                calls[named(node.func, own, names, defined)].append(node)
            elif isinstance(node, ast.Name | ast.Attribute) and id(node) not in called:
                values.add(named(node, own, names, defined))
    out = set()
    for module, tree in trees.items():
        for key, place, argument, has_default in parameters(tree, module):
            hidden = (
                f".{key.split('.')[-1]}"  # called as an attribute of what cannot be told, unless a method has the name
            )
            keys = {key} if hidden in defined else {key, hidden}
            its = [call for k in keys for call in calls[k]]
            if module.startswith(PUBLIC) or defined[key] > 1 or keys & values or not its:
                continue
            texts = [given(call, place, argument.arg) for call in its]
            same = len(texts) > 1 and len(set(texts)) == 1 and CONSTANT.fullmatch(texts[0])
            if (has_default and not any(texts)) or same:
                out.add(f"{key if key[0] != '.' else module + key}({argument.arg})")
    return out


def options() -> Iterator[tuple[str, str]]:
    """(plug-in, option) of stages, formats, cleaning rules, model families and targets that may be left out."""
    for kind in (STAGES, FORMATS, RULES, FAMILIES, TARGETS):
        for entry in kind:
            model = getattr(entry, "Options", entry)
            for name, field in getattr(model, "model_fields", {}).items():
                if not field.is_required() and name != "kind":
                    yield f"{getattr(model, '__module__', '')}".removeprefix("errpipe."), name


def unstated(stated: str, all_options: Iterator[tuple[str, str]]) -> set[str]:
    """Options that no text sets as a key (`name:`), an argument (`name=`) or a quoted key."""
    words = set(re.findall(r"""([A-Za-z_]\w*)["']?\s*[:=]""", stated))
    return {f"{module}.{name}" for module, name in all_options if name not in words}


@pytest.fixture(scope="module")
def trees() -> dict[str, ast.Module]:
    paths = [p for folder in CALLERS for p in sorted((ROOT / folder).rglob("*.py"))]
    code = {module_of(p): tree for p, tree in parsed(paths).items()}
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]
    blocks = [
        b for p in pages for b in re.findall(r"(?<!-->\n)```python\n(.*?)```", p.read_text(encoding="utf-8"), re.S)
    ]
    return code | {f"docs.{n}": ast.parse(b) for n, b in enumerate(blocks)}


def test_every_parameter_is_set_by_some_call(trees: dict[str, ast.Module]) -> None:
    own = {m: t for m, t in trees.items() if not m.startswith((*CALLERS[1:], "docs"))}
    found = unset(own, {m: t for m, t in trees.items() if m not in own})
    assert found == set(KNOWN), f"set by nobody: {sorted(found - set(KNOWN))}; not needed: {sorted(set(KNOWN) - found)}"


def test_an_unused_parameter_is_reported() -> None:
    source = (
        "def f(a, b=1, *, c=2): pass\ndef g(a, way): pass\ndef handed(a=1): pass\n"
        "class K:\n    def m(self, deep=False): pass\n"
    )
    calls = "from errpipe import a\nfrom errpipe.a import g, handed\na.f(1, c=3)\na.f(2)\nK().m()\n"
    calls += "g(1, True)\ng(2, True)\nhanded()\nmap(handed, [])\n"
    assert unset({"a": ast.parse(source)}, {"b": ast.parse(calls)}) == {"a.f(b)", "a.g(way)", "a.m(deep)"}


def test_every_option_is_stated_somewhere() -> None:
    files = [p for f in (*CALLERS[1:], "pipelines") for e in ("*.py", "*.yaml", "*.md") for p in (ROOT / f).rglob(e)]
    files += [p for p in (ROOT / "docs").glob("*.md") if p.name not in GENERATED] + [ROOT / "README.md"]
    files += [*(ROOT / "errpipe").rglob("*.yaml"), *(ROOT / "errpipe").rglob("*.j2")]
    stated = "\n".join(p.read_text(encoding="utf-8", errors="replace") for p in files if p.name != Path(__file__).name)
    found = unstated(stated, options())
    assert found == set(KNOWN_OPTIONS), sorted(found ^ set(KNOWN_OPTIONS))


def test_an_option_that_nothing_states_is_seen() -> None:
    known = [("stages.fit", "used"), ("stages.fit", "passed"), ("stages.fit", "quoted"), ("stages.fit", "forgotten")]
    stated = "{kind: fit, used: 3}\nFit(passed=1)\n{'quoted': 2}\nforgotten is a word here"
    assert unstated(stated, iter(known)) == {"stages.fit.forgotten"}


def unread(trees: Mapping[str, ast.Module], templates: str = "") -> set[str]:
    """Fields of dataclasses whose name no attribute that is read has, and no word of a template."""
    nodes = (node for tree in trees.values() for node in ast.walk(tree))
    read = {n.attr for n in nodes if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Load)}
    read |= set(re.findall(r"\w+", templates))
    out = set()
    for module, tree in trees.items():
        for top in tree.body:
            if isinstance(top, ast.ClassDef) and any("dataclass" in ast.unparse(d) for d in top.decorator_list):
                fields = (ast.unparse(n.target) for n in top.body if isinstance(n, ast.AnnAssign))
                out |= {f"{module}.{top.name}.{name}" for name in fields if name not in read}
    return out


def test_every_field_of_a_dataclass_is_read(trees: dict[str, ast.Module]) -> None:
    own = {m: t for m, t in trees.items() if not m.startswith((*CALLERS[1:], "docs"))}
    templates = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "errpipe").rglob("*.j2"))
    found = unread(own, templates)
    assert found == set(KNOWN_FIELDS), sorted(found ^ set(KNOWN_FIELDS))


def test_an_unused_field_is_reported() -> None:
    source = "@dataclass(frozen=True)\nclass A:\n    used: int\n    shown: int\n    forgotten: int = 0\n"
    source += "class B:\n    other: int\nprint(a.used)\na.forgotten = 1\n"
    assert unread({"m": ast.parse(source)}, "{{ page.shown }}") == {"m.A.forgotten"}
