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
    """The links of all stages, and what is wrong with them: duplicate names, missing sources, unused outputs.

    An artefact that no stage reads although a later stage takes its type is an error: it would be ignored.
    """
    links: dict[str, dict[str, tuple[str, ...]]] = {}
    wrong: Found = []
    before: list[Stage] = []
    for number, stage in enumerate(stages):
        if stage.label in links:
            hint = "give one of them a name" if stage.name is None else "names must differ"
            wrong.append(((number,), f"a second stage named {stage.label!r} ({hint})"))
        links[stage.label] = {}
        unknown = [slot for slot in stage.source if slot not in stage.takes]
        for slot in unknown:
            allowed = ", ".join(stage.takes) or "none"
            wrong.append(((number, "from", slot), f"{stage.kind} has no such source (allowed: {allowed})."))
        for slot, need in stage.takes.items():
            names, problem = _behind(stage, slot, need, before, links)
            links[stage.label][slot] = names
            if problem:
                wrong.append(((number, "from", slot) if slot in stage.source else (number,), problem))
        before.append(stage)
    return links, wrong or _unread(stages, links)


def _behind(stage: Stage, slot: str, need: Need, before: Sequence[Stage], links: Links) -> tuple[tuple[str, ...], str]:
    """Names of the stages of one slot, and its problem ('' if none)."""
    fitting = [other.label for other in before if need.type in other.gives]
    wanted = need.type.replace("_", " ")
    if slot in stage.source:
        stated = stage.source[slot]
        chosen = (stated,) if isinstance(stated, str) else stated
        for name in chosen:
            if name not in fitting:
                allowed = ", ".join(fitting) or "none"
                near = did_you_mean(name, fitting)
                return (), f"no earlier stage {name!r} gives {_with_article(wanted)} (there are: {allowed}).{near}"
        if len(chosen) != 1 and not need.every:
            return (), f"names {len(chosen)} stages (one is read)"
        return chosen, ""
    if need.only_with and not _is_provided(stage, need.only_with, before):
        return (), ""
    if not fitting and not need.optional and not (need.unless and _is_provided(stage, need.unless, before)):
        return (), f"{stage.kind} takes {_with_article(wanted)}, and no stage before it gives one"
    if not need.every:
        return tuple(fitting[-1:]), ""
    replaced = {
        name
        for other in before
        if need.type in other.gives
        for own, need_of_other in other.takes.items()
        if need_of_other.type == need.type
        for name in links[other.label][own]
    }
    return tuple(name for name in fitting if name not in replaced), ""


def models_of(stages: Sequence[Stage], links: Links, every: bool = False) -> tuple[str, ...]:
    """Names of the stages whose error models make up the table: what the last export (every: any) reads, else all."""
    need = Need("error_model", optional=True, every=True)
    exports = [
        (s.label, slot) for s in stages if "table" in s.gives for slot, n in s.takes.items() if n.type == need.type
    ]
    read = [name for label, slot in exports[0 if every else -1 :] for name in links[label][slot]]
    return tuple(dict.fromkeys(read)) if exports else _behind(stages[-1], "", need, stages, links)[0]


def _is_provided(stage: Stage, slot: str, before: Sequence[Stage]) -> bool:
    """Whether an earlier stage gives what another slot of a stage takes."""
    return any(stage.takes[slot].type in other.gives for other in before)


def _unread(stages: Sequence[Stage], links: Links) -> Found:
    """Artefacts that no stage reads although a later stage takes one of their type."""
    wrong: Found = []
    for number, stage in enumerate(stages):
        for given in stage.gives:
            takers = [
                (other.label, slot)
                for other in stages[number + 1 :]
                for slot, n in other.takes.items()
                if n.type == given
            ]
            if takers and not any(stage.label in links[name][slot] for name, slot in takers):
                reason = f"its {given.replace('_', ' ')} is not read, although a later stage takes one"
                name, slot = takers[0]
                wrong.append(
                    ((number,), f"{reason} (leave the stage out, or write from: {{{slot}: {stage.label}}} in {name})")
                )
    return wrong


def _with_article(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def ancestors(links: Links, names: Sequence[str]) -> set[str]:
    """The stages named and all that they read, directly or not."""
    above: set[str] = set()
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        if name not in above:
            above.add(name)
            waiting.extend(other for slot in links[name].values() for other in slot)
    return above


def upstream(links: Links, name: str) -> tuple[str, ...]:
    """Names of the stages that one stage reads directly, each once, in a stable order."""
    return tuple(dict.fromkeys(other for slot in links[name].values() for other in slot))
