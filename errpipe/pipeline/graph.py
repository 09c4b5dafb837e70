"""Which stage reads which: the links between stages, and what a wish (`--to`) draws in.

A stage reads stages that stand before it in the file, so the file's order is a running order and
there can be no circle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from errpipe.errors import did_you_mean
from errpipe.pipeline.stage import Need, Stage

Links = Mapping[str, Mapping[str, tuple[str, ...]]]  # stage name -> slot -> names of stages
Found = list[tuple[tuple[str | int, ...], str]]  # (place below `stages`, what is wrong)


def link(stages: Sequence[Stage]) -> tuple[Links, Found]:
    """The links of all stages, and what is wrong with them: names given twice, needs that nobody meets."""
    links: dict[str, dict[str, tuple[str, ...]]] = {}
    wrong: Found = []
    before: list[Stage] = []
    for number, stage in enumerate(stages):
        if stage.label in links:
            hint = "give one of them a name" if stage.name is None else "names must differ"
            wrong.append(((number,), f"a second stage named {stage.label!r} ({hint})"))
        links[stage.label] = {}
        unknown = [slot for slot in stage.source if slot not in stage.reads]
        for slot in unknown:
            allowed = ", ".join(stage.reads) or "none"
            wrong.append(((number, "from", slot), f"{stage.kind} has no such source (allowed: {allowed})."))
        for slot, need in stage.reads.items():
            names, problem = _behind(stage, slot, need, before)
            links[stage.label][slot] = names
            if problem:
                wrong.append(((number, "from", slot) if slot in stage.source else (number,), problem))
        before.append(stage)
    return links, wrong


def _behind(stage: Stage, slot: str, need: Need, before: Sequence[Stage]) -> tuple[tuple[str, ...], str]:
    """Names of the stages behind one slot, and what is wrong with it ('' if nothing)."""
    fitting = [other.label for other in before if other.kind in need.kinds]
    kinds = " or ".join(need.kinds)
    if slot in stage.source:
        said = stage.source[slot]
        chosen = (said,) if isinstance(said, str) else said
        for name in chosen:
            if name not in fitting:
                allowed = ", ".join(fitting) or "none"
                near = did_you_mean(name, fitting)
                return (), f"no earlier stage {name!r} of kind {kinds} (there are: {allowed}).{near}"
        if len(chosen) != 1 and not need.every:
            return (), f"names {len(chosen)} stages (one is read)"
        return chosen, ""
    if not fitting and not need.optional:
        return (), f"{stage.kind} reads a stage of kind {kinds}, and none stands before it"
    return tuple(fitting if need.every else fitting[-1:]), ""


def ancestors(links: Links, names: Sequence[str]) -> set[str]:
    """The stages named and all that they read, directly or not."""
    found: set[str] = set()
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting.extend(other for slot in links[name].values() for other in slot)
    return found


def reads_of(links: Links, name: str) -> tuple[str, ...]:
    """Names of the stages that one stage reads directly, each once, in a stable order."""
    return tuple(dict.fromkeys(other for slot in links[name].values() for other in slot))
