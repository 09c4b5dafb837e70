"""Structured Text to C, so that tests can run it: once by lines and tokens, once from the syntax tree of blark.

Both cover what the exported blocks use (see `st/*.st`) and refuse the rest. How LREAL_TO_DINT rounds is a parameter:
real compilers differ, and the exported code must not depend on it.
"""

from __future__ import annotations

import re
from typing import ClassVar

PRELUDE = """
#include <stdint.h>
#include <stddef.h>
#include <math.h>
typedef double LREAL; typedef int32_t DINT; typedef int32_t BOOL; typedef uint8_t BYTE; typedef uint32_t DWORD;
#define TRUE 1
#define FALSE 0
#define BYTE_TO_DINT(x) ((int32_t)(x))
#define BYTE_TO_DWORD(x) ((uint32_t)(x))
#define DINT_TO_LREAL(x) ((double)(x))
#define LREAL_TO_DINT(x) ((int32_t)ROUNDING(x))
#define SHL(x, n) ((uint32_t)(x) << (n))
#define SHR(x, n) ((uint32_t)(x) >> (n))
"""
DECLARATION = re.compile(r"^ +(\w+) : (?:ARRAY \[(\d+)\.\.(\d+)\] OF )?(\w+)(?: := (.*))?;$")
TOKEN = re.compile(r"\s*(DWORD#16#\w+|BYTE#\d+|[\d.]+E-?\d+|\d+\.\d+|\d+|[A-Za-z]\w*|:=|<>|<=|>=|[-+*/=<>()\[\],.;])")
WORDS = {"OR": "||", "AND": "&&", "NOT": "!", "MOD": "%", "=": "==", "<>": "!="}
BITS = {"OR": "|", "AND": "&", "XOR": "^"}


class Unit:
    """One type, function or block: its kind, name and variables by section."""

    known: ClassVar[dict[str, Unit]] = {}

    def __init__(self, text: str):
        self.text = re.sub(r"\(\*.*?\*\)", "", text, flags=re.S)
        head = re.search(r"^(TYPE|FUNCTION_BLOCK|FUNCTION) (\w+)(?: : (\w+))?", self.text, re.M)
        self.kind, self.name, self.result = head.groups()
        self.sections: dict[str, list[tuple]] = {}
        section, body = "", []
        for line in self.text[head.start() :].splitlines()[1:]:
            if line in ("VAR", "VAR_INPUT", "VAR_OUTPUT", "VAR_IN_OUT", "STRUCT"):
                section = line
            elif line in ("END_VAR", "END_STRUCT;"):
                section = "-"
            elif section not in ("", "-"):
                self.sections.setdefault(section, []).append(DECLARATION.match(line).groups())
            elif section == "-" and not line.startswith("END_"):
                body.append(line.strip())
        self.body = [line for line in body if line]
        self.known[self.name] = self

    def names(self, *sections):
        return {v[0]: v for s in sections for v in self.sections.get(s, [])}


def field(variable) -> str:
    name, low, high, base, _ = variable
    return f"{base} {name}" + ("" if low is None else f"[{int(high) - int(low) + 1}]")


def place(unit: Unit, name: str) -> str:
    """How C reaches a variable of a unit."""
    if name == unit.name:
        return "result"
    if name in unit.names("VAR_IN_OUT"):
        return f"(*{name})"
    return f"self->{name}" if unit.kind == "FUNCTION_BLOCK" else name


def shift(unit: Unit, name: str) -> int:
    """Lowest index of an array."""
    own = unit.names("VAR", "VAR_INPUT", "VAR_OUTPUT")
    return int(own[name][1] or 0) if name in own and own[name][1] else 0


def expression(unit: Unit, text: str) -> str:
    """One expression by its tokens."""
    known = unit.names("VAR", "VAR_INPUT", "VAR_OUTPUT", "VAR_IN_OUT")
    bits = "DWORD" in text or "SHL" in text
    out, at, lowest = [], 0, 0
    while at < len(text.rstrip()):
        match = TOKEN.match(text, at)
        assert match, text[at:]
        token, at = match[1], match.end()
        member = out and out[-1] == "."
        if token in WORDS or token == "XOR":
            out.append(BITS[token] if bits and token in BITS else WORDS[token])
        elif token.startswith("DWORD#16#"):
            out.append(f"0x{token[9:]}u")
        elif token.startswith("BYTE#"):
            out.append(token[5:])
        elif (token in known or token == unit.name) and not member:
            lowest = shift(unit, token)
            out.append(place(unit, token))
        else:
            out.append(f"[-{lowest} + " if token == "[" else token)
    return " ".join(out)


def statement(unit: Unit, line: str) -> str:
    """One line of a body."""
    expr = lambda text: expression(unit, text)  # noqa: E731
    if m := re.match(r"IF (.*) THEN$", line):
        return f"if ({expr(m[1])}) {{"
    if m := re.match(r"ELSIF (.*) THEN$", line):
        return f"}} else if ({expr(m[1])}) {{"
    if line == "ELSE":
        return "} else {"
    if m := re.match(r"FOR (\w+) := (.*) TO (.*) DO$", line):
        v = place(unit, m[1])
        return f"for ({v} = {expr(m[2])}; {v} <= {expr(m[3])}; {v}++) {{"
    if m := re.match(r"WHILE (.*) DO$", line):
        return f"while ({expr(m[1])}) {{"
    if line in ("END_IF;", "END_FOR;", "END_WHILE;"):
        return "}"
    if line == "EXIT;":
        return "break;"
    if m := re.match(r"(fb\w+)\((.*)\);$", line):
        return call(unit, m[1], [(a, expr(b)) for a, b in re.findall(r"(\w+) := ([^,]+)", m[2])])
    left, right = re.match(r"(.*?) := (.*);$", line).groups()
    if unit.names("VAR_IN_OUT").get(left, ("",) * 4)[3] == "ECT_FILE":
        return f"__builtin_memcpy(&{expr(left)}, &{expr(right)}, sizeof {expr(left)});"
    return f"{expr(left)} = {expr(right)};"


def call(unit: Unit, name: str, given: list[tuple[str, str]]) -> str:
    """A call of a function block: inputs are set, what is passed by reference follows the block in its own order."""
    block = unit.names("VAR")[name][3]
    mine = place(unit, name)
    own = Unit.known[block].names("VAR_IN_OUT")
    sets = "".join(f"{mine}.{a} = {b}; " for a, b in given if a not in own)
    passed = "".join(f", &({dict(given)[a]})" for a in own)
    return f"{sets}{block}_run(&{mine}{passed});"


def frame(unit: Unit, body: list[str]) -> str:
    """The C of a unit around its translated body."""
    if unit.kind == "TYPE" and "STRUCT" in unit.sections:
        return f"typedef struct {{ {'; '.join(map(field, unit.sections['STRUCT']))}; }} {unit.name};"
    if unit.kind == "TYPE":
        low, high, base = re.search(r"ARRAY \[(\d+)\.\.(\d+)\] OF (\w+)", unit.text).groups()
        return f"typedef {base} {unit.name}[{int(high) - int(low) + 1}];"
    lines = "\n".join(body)
    if unit.kind == "FUNCTION":
        given = ", ".join(map(field, unit.sections["VAR_INPUT"]))
        own = "".join(f"{field(v)};\n" for v in unit.sections.get("VAR", []))
        start = f"{unit.result} result = 0;\n{own}"
        return f"static {unit.result} {unit.name}({given}) {{ {start}{lines}\nreturn result; }}"
    inside = [v for s in ("VAR_INPUT", "VAR_OUTPUT", "VAR") for v in unit.sections.get(s, [])]
    given = "".join(f", {v[3]} *{v[0]}" for v in unit.sections.get("VAR_IN_OUT", []))
    struct = f"typedef struct {{ {'; '.join(map(field, inside))}; }} {unit.name};"
    start = "".join(
        f"static const DINT {v[0]}[] = {{{v[4].strip('[]')}}}; __builtin_memcpy(self->{v[0]}, {v[0]}, sizeof {v[0]});"
        for v in inside
        if v[4]
    )
    return f"{struct}\nstatic void {unit.name}_run({unit.name} *self{given}) {{ {start}\n{lines}\n}}"


HARNESS = """
static ECT_FILE file; static ECT_TABLE table; static ECT_INPUTS readings; static ECT_FRESH fresh;
static ECT_OUTPUTS deviation, correction; static FB_EctLoad loader; static FB_EctCycle block;
int load(const uint8_t *data, size_t size, DINT *where)
{
    __builtin_memset(file, 0, sizeof file);
    if (size > sizeof file) { return 3; }
    __builtin_memcpy(file, data, size);
    loader.nSize = (DINT)size;
    FB_EctLoad_run(&loader, &file, &table);
    *where = loader.nWhere;
    return loader.nError;
}
int stream(const uint8_t *data, size_t size, size_t cycles, const double *given, const uint8_t *news,
           const uint8_t *mode, double *d, double *c, uint32_t *status)
{
    DINT where;
    size_t k;
    int i, error = load(data, size, &where);
    __builtin_memset(&block, 0, sizeof block);
    for (k = 0; error == 0 && k < cycles; k++) {
        for (i = 0; i < table.nInputs; i++) {
            readings[i] = given[k * (size_t)table.nInputs + (size_t)i];
            fresh[i] = news[k * (size_t)table.nInputs + (size_t)i];
        }
        block.bEnable = mode[k] == 1;
        block.bHold = mode[k] == 2;
        FB_EctCycle_run(&block, &table, &readings, &fresh, &deviation, &correction);
        for (i = 0; i < table.nOutputs; i++) {
            d[k * (size_t)table.nOutputs + (size_t)i] = deviation[i];
            c[k * (size_t)table.nOutputs + (size_t)i] = correction[i];
        }
        status[k] = (uint32_t)block.nStatus;
    }
    return error;
}
/* One session: two tables, of which FB_EctSwitch says which one runs. */
static ECT_TABLE first, second; static FB_EctSwitch switcher; static int resets;
static int exchange(const uint8_t *data, size_t size)
{
    ECT_TABLE *spare = switcher.nActive == 1 ? &second : &first;
    __builtin_memset(file, 0, sizeof file);
    __builtin_memcpy(file, data, size);
    loader.nSize = (DINT)size;
    FB_EctLoad_run(&loader, &file, spare);
    switcher.bSwitch = 0;
    FB_EctSwitch_run(&switcher, &first, &second);
    switcher.bSwitch = 1;
    FB_EctSwitch_run(&switcher, &first, &second);
    return !switcher.bRefused;
}
void *session_open(const uint8_t *data, size_t size)
{
    __builtin_memset(&block, 0, sizeof block);
    __builtin_memset(&switcher, 0, sizeof switcher);
    __builtin_memset(&first, 0, sizeof first);
    __builtin_memset(&second, 0, sizeof second);
    resets = 0;
    return exchange(data, size) ? &switcher : 0;
}
int session_reload(void *s, const uint8_t *data, size_t size) { (void)s; return exchange(data, size); }
void session_reset(void *s) { (void)s; resets = 1; }
void session_close(void *s) { (void)s; }
void session_run(void *s, size_t cycles, const double *given, const uint8_t *news, const uint8_t *mode, double *c,
                 uint32_t *status)
{
    size_t k;
    int i;
    (void)s;
    for (k = 0; k < cycles; k++) {
        ECT_TABLE *own = switcher.nActive == 1 ? &first : &second;
        for (i = 0; i < own->nInputs; i++) {
            readings[i] = given[k * (size_t)own->nInputs + (size_t)i];
            fresh[i] = news[k * (size_t)own->nInputs + (size_t)i];
        }
        block.bEnable = mode[k] == 1;
        block.bHold = mode[k] == 2;
        block.bReset = resets;
        resets = 0;
        FB_EctCycle_run(&block, own, &readings, &fresh, &deviation, &correction);
        for (i = 0; i < own->nOutputs; i++) {
            c[k * (size_t)own->nOutputs + (size_t)i] = correction[i];
        }
        status[k] = (uint32_t)block.nStatus;
    }
}
"""


def by_lines(units: list[str]) -> str:
    """C of all units, translated line by line."""
    parsed = [Unit(text) for text in units]
    return PRELUDE + "\n".join(frame(u, [statement(u, line) for line in u.body]) for u in parsed) + HARNESS


# from blark's syntax tree ------------------------------------------------------------------------------


def tree_expression(unit: Unit, e) -> str:
    """One expression of the syntax tree."""
    again = lambda x: tree_expression(unit, x)  # noqa: E731
    kind = type(e).__name__
    if kind == "BinaryOperation":
        op, left, right = str(e.op).upper(), again(e.left), again(e.right)
        bits = op == "XOR" or re.search(r"0x\w+u|SHL|DWORD", left + right)
        return f"({left} {(BITS if bits and op in BITS else WORDS).get(op, op)} {right})"
    if kind == "UnaryOperation":
        return f"({'!' if str(e.op).upper() == 'NOT' else '-'}{again(e.expr)})"
    if kind == "ParenthesizedExpression":
        return f"({again(e.expr)})"
    if kind == "SimpleVariable":
        name = str(e.name)
        return place(unit, name) if name in unit.names(*unit.sections) or name == unit.name else name
    if kind == "MultiElementVariable":
        out = place(unit, str(e.name))
        for part in e.elements:
            if type(part).__name__ == "SubscriptList":
                out += f"[({again(part.subscripts[0])}) - {shift(unit, str(e.name))}]"
            else:
                out += f".{part.field}"
        return out
    if kind == "FunctionCall":
        return f"{e.name}({', '.join(again(p.value) for p in e.parameters)})"
    if kind == "Boolean":
        return str(e).upper()
    return re.sub(r"^BYTE#", "", re.sub(r"^DWORD#16#(\w+)$", r"0x\1u", str(e)))


def tree_block(unit: Unit, block) -> str:
    return "\n".join(tree_statement(unit, s) for s in block.statements) if block is not None else ""


def tree_statement(unit: Unit, s) -> str:
    """One statement of the syntax tree."""
    ex = lambda e: tree_expression(unit, e)  # noqa: E731
    kind = type(s).__name__
    if kind == "AssignmentStatement":
        if str(s.expression) in unit.names("VAR_IN_OUT"):  # a whole array
            return f"__builtin_memcpy(&{ex(s.variables[0])}, &{ex(s.expression)}, sizeof {ex(s.expression)});"
        return "".join(f"{ex(v)} = " for v in s.variables) + ex(s.expression) + ";"
    if kind == "IfStatement":
        out = f"if ({ex(s.if_expression)}) {{\n{tree_block(unit, s.statements)}\n}}"
        for branch in s.else_ifs:
            out += f" else if ({ex(branch.if_expression)}) {{\n{tree_block(unit, branch.statements)}\n}}"
        if s.else_clause is not None:
            out += f" else {{\n{tree_block(unit, s.else_clause.statements)}\n}}"
        return out
    if kind == "ForStatement":
        v = ex(s.control)
        return f"for ({v} = {ex(s.from_)}; {v} <= {ex(s.to)}; {v}++) {{\n{tree_block(unit, s.statements)}\n}}"
    if kind == "WhileStatement":
        return f"while ({ex(s.expression)}) {{\n{tree_block(unit, s.statements)}\n}}"
    if kind == "ExitStatement":
        return "break;"
    if kind == "FunctionCallStatement":
        return call(unit, str(s.name), [(str(p.name), ex(p.value)) for p in s.parameters])
    raise NotImplementedError(f"{kind}: {s}")


def by_tree(units: list[str]) -> str:
    """C of all units, bodies translated from what blark parsed."""
    from blark.parse import parse_source_code

    out = []
    for text in units:
        parsed = parse_source_code(text)
        if parsed.exception:
            raise parsed.exception
        unit = Unit(text)
        (item,) = parsed.transform().items
        body = getattr(item, "body", None)
        out.append(frame(unit, [tree_block(unit, body)]))
    return PRELUDE + "\n".join(out) + HARNESS
