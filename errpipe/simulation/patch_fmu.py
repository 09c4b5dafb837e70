"""A patch as a Functional Mock-up Unit (FMI 2.0, co-simulation): generated C, compiled if there is a compiler.

Inputs have the names of the recording's columns, outputs those of its responses, in the same units: `errpipe diagnose
--simulation` and any FMI master connect them by name. Without a compiler the FMU contains only its sources.
"""

from __future__ import annotations

import io
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from importlib.resources import files
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from errpipe import jsonfile
from errpipe.domain.recording import Recording
from errpipe.simulation.patch import Piece, Program, Statement

NAME = "patch"
STEPWISE = ("direction", "coolant", "spindle_speed", "feed", "load", "overhang", "depth_of_cut")  # held between rows
HISTORY = 1100  # stored values of a delay, one per thousandth of it (as `HISTORY` in the template)
# Number of states of each operation.
STATE_WIDTH = {"lag": 1, "first": 1, "switch": 1, "side": 1, "direction": 2, "approach": 2, "ringing": 3}
STATE_WIDTH["late"] = 3 + 2 * HISTORY
STEPS_PER_ROW = 20.0  # the FMU's own step; outputs are delayed by one step
COMPILE_TIMEOUT = 120.0  # s


def build(pieces: tuple[Piece, ...], recording: Recording) -> tuple[bytes, str]:
    """The FMU's bytes, and the reason if it has no binary ('' if it has). Equal pieces give equal sources."""
    program = Program(pieces, recording)
    components = list(dict.fromkeys(p.component for p in pieces))
    header = _equations(program, components)
    guid = "{" + jsonfile.fingerprint_bytes(header.encode())[:32] + "}"
    header = f'#define GUID "{guid}"\n' + header
    source = files("errpipe.simulation").joinpath("templates/fmi2_patch.c").read_text(encoding="utf-8")
    binary, problem = compiled({"equations.h": header, f"{NAME}.c": source})
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        members = {
            "modelDescription.xml": _description(program, recording, components, guid).encode(),
            f"sources/{NAME}.c": source.encode(),
            "sources/equations.h": header.encode(),
        }
        if binary is not None:
            system = {"win32": "win", "darwin": "darwin"}.get(sys.platform, "linux")
            members[f"binaries/{system}{'64' if sys.maxsize > 2**32 else '32'}/{NAME}{_suffix()}"] = binary
        for name, data in members.items():
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), data)
    return out.getvalue(), problem


def c_compiler() -> str | None:
    """Path of the C compiler of this host, if it has one."""
    return next((path for name in ("cc", "gcc", "clang") if (path := shutil.which(name))), None)


def compiled(sources: dict[str, str]) -> tuple[bytes | None, str]:
    """The shared library, or None and the reason."""
    compiler = c_compiler()
    if compiler is None:
        return None, "no C compiler was found: the FMU contains only its sources"
    with tempfile.TemporaryDirectory(prefix="errpipe-patch-") as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        command = [compiler, "-O2", "-shared", "-o", f"{NAME}{_suffix()}", f"{NAME}.c", "-lm"]
        command[2:2] = ["-fPIC", "-fvisibility=hidden", "-ffp-contract=off"] if sys.platform != "win32" else []
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, timeout=COMPILE_TIMEOUT, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as err:
            return None, f"the C compiler did not run ({type(err).__name__}): the FMU contains only its sources"
        library = Path(folder) / f"{NAME}{_suffix()}"
        if done.returncode or not library.is_file():
            return None, "the C compiler rejected the sources: the FMU contains only them"
        return library.read_bytes(), ""


def _suffix() -> str:
    return {"Windows": ".dll", "Darwin": ".dylib"}.get(platform.system(), ".so")


def _equations(program: Program, components: list[str]) -> str:
    """The generated header: sizes, starting values, tables and one line for each statement."""
    inputs, tables, lines, state = program.inputs(), [], [], 0
    for n, s in enumerate(program.statements):
        if s.op == "lookup":
            values = s["values"]
            tables.append(f"static const double T{n}[{len(values)}] = {{{', '.join(f'{v:.17g}' for v in values)}}};")  # type: ignore[arg-type,attr-defined]
        lines.append(f"double n{n} = {_c(n, s, inputs, state)};")
        state += STATE_WIDTH.get(s.op, 0)
    for k, component in enumerate(components):
        own = [r for p, r in zip(program.pieces, program.results, strict=True) if p.component == component]
        lines.append(f"out[{k}] = {' + '.join(f'n{r}' for r in own)};")
    starts = [f"{v:.17g}" for v in _starts(program)] + ["0.0"] * len(components)
    sizes = f"#define INPUTS {len(inputs)}\n#define OUTPUTS {len(components)}\n#define STATES {state}\n"
    sizes += f"#define STARTS {', '.join(starts)}\n"
    equations = " \\\n    ".join(["#define EQUATIONS", *lines])
    return sizes + "\n".join(tables) + f"\n{equations}\n"


def _starts(program: Program) -> list[float]:
    """Values of inputs until they are set: their first reading."""
    out = []
    for name in program.inputs():
        values = program.recording.array(name)
        known = values[np.isfinite(values)]
        out.append(float(known[0]) if known.size else 0.0)
    return out


def _c(n: int, s: Statement, inputs: tuple[str, ...], state: int) -> str:
    """A statement as a C expression; `state` is the index of its first state."""
    of = [f"n{k}" for k in s.of]
    number = {name: f"{float(v):.17g}" for name, v in s.constants if isinstance(v, int | float)}
    match s.op:
        case "input":
            return f"in[{inputs.index(str(s['name']))}]"
        case "constant":
            return number["value"]
        case "affine":
            parts = [f"({w:.17g}) * {k}" for w, k in zip(s["weights"], of, strict=True)]  # type: ignore[call-overload]
            return f"({number['offset']}) + " + " + ".join(parts)
        case "product":
            return " * ".join(of)
        case "power":
            return f"power_of({of[0]}, {number['exponent']})"
        case "clip":
            return f"clipped({of[0]}, {number['low']}, {number['high']})"
        case "within":
            return f"({of[0]} >= ({number['low']}) && {of[0]} <= ({number['high']})) ? 1.0 : 0.0"
        case "lookup":
            last = len(s["values"]) - 1  # type: ignore[arg-type]
            return f"table_at(T{n}, {last}, {number['start']}, {number['step']}, {number['period']}, {of[0]})"
        case "lag":
            start = int(s["start"] == "input")
            return f"lagged(m, {state}, {of[0]}, {number['up']}, {number['down']}, {start}, dt)"
        case "ringing" | "late":
            rest = "".join(f", {number[key]}" for key, _ in s.constants)
            return f"{s.op}_of(m, {state}, {of[0]}{rest}, dt)"
    name = {"switch": "switched", "approach": "approached"}.get(s.op, f"{s.op}_of")
    rest = "".join(f", {number[key]}" for key, _ in s.constants)
    return f"{name}(m, {state}, {', '.join(of)}{rest})"


def _description(program: Program, recording: Recording, components: list[str], guid: str) -> str:
    """modelDescription.xml of FMI 2.0."""
    kinds, inputs, starts = recording.manifest.columns, program.inputs(), _starts(program)
    units = [kinds[n].unit for n in inputs]
    units += [next(p.unit for p in program.pieces if p.component == c) for c in components]
    step = np.diff(recording.time())
    step = step[step > 0]
    size = float(np.median(step)) / STEPS_PER_ROW if step.size else 1.0
    variables = []
    for k, (name, start) in enumerate(zip(inputs, starts, strict=True)):
        held = "discrete" if kinds[name].role in STEPWISE else "continuous"
        unit = f" unit={quoteattr(str(units[k]))}" if units[k] else ""
        head = f'<ScalarVariable name={quoteattr(name)} valueReference="{k}" causality="input" variability="{held}">'
        variables.append(f'{head}<Real start="{start!r}"{unit}/></ScalarVariable>')
    for k, component in enumerate(components, start=len(inputs)):
        says = "; ".join(p.summary for p in program.pieces if p.component == component)
        head = f'<ScalarVariable name={quoteattr(component)} valueReference="{k}" causality="output" '
        head += f'description={quoteattr(says)} variability="continuous">'
        variables.append(f"{head}<Real unit={quoteattr(str(units[k]))}/></ScalarVariable>")
    named = "".join(f"<Unit name={quoteattr(u)}/>" for u in sorted({u for u in units if u}))
    outputs = "".join(f'<Unknown index="{k + 1}"/>' for k in range(len(inputs), len(inputs) + len(components)))
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="2.0" modelName="{NAME}" guid="{guid}" generationTool="errpipe" '
        'variableNamingConvention="flat" description="Deviations (actual minus commanded) to add to a simulation">',
        f'<CoSimulation modelIdentifier="{NAME}" canHandleVariableCommunicationStepSize="true" '
        'canGetAndSetFMUstate="true"><SourceFiles><File name="patch.c"/></SourceFiles></CoSimulation>',
        f"<UnitDefinitions>{named}</UnitDefinitions>",
        f'<DefaultExperiment startTime="0.0" stepSize="{size!r}"/>',
        "<ModelVariables>",
        *variables,
        "</ModelVariables>",
        f"<ModelStructure><Outputs>{outputs}</Outputs><InitialUnknowns>{outputs}</InitialUnknowns></ModelStructure>",
        "</fmiModelDescription>",
    ]
    return "\n".join(lines) + "\n"
