"""One rule of the format changed at a time: which changes do the golden vectors not see?

`python -m tests.golden.mutants` takes the second evaluator (written from the format's page) apart: each comparison,
sign, number, condition and statement of it is changed by itself, and the golden vectors are run. A change that passes
all of them is printed: a rule that no vector tests, or a change that changes nothing.
"""

from __future__ import annotations

import ast
import copy
import struct
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.contract import second_cycle, second_functions, second_reader
from tests.golden import vectors

SIDES: dict[type, type] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
}
SIGNS: dict[type, type] = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
# What is not a rule of the cycle: rounding to single precision, names, faults and sources (no part of the vectors).
LEFT_OUT = {"_rounded", "_creep", "__init__", "reset", "cycle", "Cycle"}
FUNCTIONS = {"exp", "ln", "power"}


def _swaps(node: ast.AST) -> Iterator[ast.AST]:
    """Everything that may stand in one place instead of what stands there."""
    match node:
        case ast.Compare():
            for n, op in enumerate(node.ops):
                if type(op) in SIDES:
                    new = copy.deepcopy(node)
                    new.ops[n] = SIDES[type(op)]()
                    yield new
            yield from (ast.Constant(True), ast.Constant(False))
        case ast.BoolOp():
            yield ast.BoolOp(op=ast.Or() if isinstance(node.op, ast.And) else ast.And(), values=node.values)
            for n in range(len(node.values)):
                rest = node.values[:n] + node.values[n + 1 :]
                yield rest[0] if len(rest) == 1 else ast.BoolOp(op=node.op, values=rest)
        case ast.BinOp() if type(node.op) in SIGNS:
            yield ast.BinOp(left=node.left, op=SIGNS[type(node.op)](), right=node.right)
            yield from (node.left, node.right)
        case ast.UnaryOp():
            yield node.operand
        case ast.IfExp():
            yield from (node.body, node.orelse)
        case ast.Call(func=ast.Name(id="abs")):
            yield node.args[0]
        case ast.Call(func=ast.Name(id=("min" | "max") as name), args=[first, second]):
            yield ast.Call(
                func=ast.Name(id="max" if name == "min" else "min", ctx=ast.Load()), args=node.args, keywords=[]
            )
            yield from (first, second)
        case ast.Call(func=ast.Name(id="is_sane")):
            yield ast.Constant(True)
        case ast.Constant(value=bool()):
            yield ast.Constant(not node.value)
        case ast.Constant(value=(int() | float()) as value):
            yield ast.Constant(value + 1)
        case ast.Assign() | ast.AugAssign():
            yield ast.Pass()


def mutants(path: Path) -> Iterator[tuple[str, types.CodeType]]:
    """(what was changed, the module) for each change of a module of the second evaluator."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for function in [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)]:
        if function.name in LEFT_OUT or (path.stem == "second_functions" and function.name not in FUNCTIONS):
            continue
        left_out = {id(n) for top in ast.walk(function) if _is_left_out(top) for n in ast.walk(top)}
        for parent in ast.walk(function):
            if id(parent) in left_out:
                continue
            for field, old in ast.iter_fields(parent):
                if parent is function and field != "body":
                    continue
                for place, child in enumerate(old) if isinstance(old, list) else [(None, old)]:
                    if not isinstance(child, ast.AST):
                        continue
                    for new in _swaps(child):
                        yield _named(function, parent, child, new), _changed(tree, parent, field, place, new)


def _is_left_out(node: ast.AST) -> bool:
    """Loops, which changed may not end; what is of single precision alone; keywords as in zip(strict=True)."""
    single = isinstance(node, ast.If | ast.IfExp) and ast.unparse(node.test) in ("single", "self.single")
    return single or isinstance(node, ast.While | ast.keyword)


def _named(function: ast.FunctionDef, parent: ast.AST, old: ast.AST, new: ast.AST) -> str:
    shown = ast.unparse(ast.fix_missing_locations(copy.deepcopy(new)))
    where = f" in {ast.unparse(parent)}" if isinstance(old, ast.Constant) else ""
    return f"{function.name}: {ast.unparse(old)} -> {shown}{where}"


def _changed(tree: ast.Module, parent: ast.AST, field: str, place: int | None, new: ast.AST) -> types.CodeType:
    """The module compiled with one node in another's place; the tree is as before."""
    old = getattr(parent, field)
    put = new if place is None else [*old[:place], new, *old[place + 1 :]]
    for node in ast.walk(new):
        for name in ("lineno", "col_offset", "end_lineno", "end_col_offset"):
            if not hasattr(node, name):
                setattr(node, name, 1)
    setattr(parent, field, put)
    try:
        return compile(tree, "mutant", "exec")
    finally:
        setattr(parent, field, old)


def module(code: types.CodeType, name: str, **more: Any) -> types.ModuleType:
    """A module of the second evaluator, changed."""
    made = types.ModuleType(name)
    sys.modules[name] = made
    exec(code, made.__dict__)
    made.__dict__.update(more)
    return made


def is_seen(evaluator: Any, blocks: list[tuple[Any, ...]]) -> bool:
    """Does some golden vector differ, or some cycle fail? The block that shows it comes first the next time."""
    for place, (table, readings, fresh, enable, results, status) in enumerate(blocks):
        try:
            under = evaluator(table)
            for k, row in enumerate(readings):
                given = [v if new else None for v, new in zip(row, fresh[k], strict=True)]
                cycle = under.cycle(enable[k], given)
                if cycle.status != status[k] or bits(cycle.deviations + cycle.corrections) != results[k]:
                    break
            else:
                continue
        except (ArithmeticError, AttributeError, IndexError, NameError, TypeError, ValueError):
            pass
        blocks.insert(0, blocks.pop(place))
        return True
    return False


def bits(numbers: Any) -> bytes:
    """Every bit of some numbers, the sign of a zero too."""
    return struct.pack(f"<{len(numbers)}d", *numbers)


def blocks() -> list[tuple[Any, ...]]:
    """The golden file as plain Python, the cheapest tables first."""
    out = []
    for _, data, readings, fresh, enable, results, status in vectors.golden():
        plain = (readings.tolist(), fresh.tolist(), enable.tolist(), [bits(r) for r in results], status.tolist())
        out.append((second_reader.load(data), *plain))
    return sorted(out, key=lambda b: len(b[1]) * len(b[0].nodes))


def unseen() -> tuple[int, list[str]]:
    """How many changes were made, and those that no vector sees."""
    cases, made, left = blocks(), 0, []
    assert not is_seen(second_cycle.Evaluator, cases)
    for what, code in mutants(Path(second_cycle.__file__)):
        made += 1
        if not is_seen(module(code, "mutant").Evaluator, cases):
            left.append(what)
    plain = compile(Path(second_cycle.__file__).read_text(encoding="utf-8"), "plain", "exec")
    for what, code in mutants(Path(second_functions.__file__)):
        if "if single" in what:
            continue
        made += 1
        changed = module(code, "mutant_functions")
        if not is_seen(module(plain, "mutant", exp=changed.exp, power=changed.power).Evaluator, cases):
            left.append(what)
    return made, left


if __name__ == "__main__":
    count, found = unseen()
    print(f"{count} changes, {len(found)} of them unseen")
    print("\n".join(found))
