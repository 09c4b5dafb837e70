"""Machines of one type together: pooled parameters, homogeneous groups, priors for machines with few runs."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from typing import Any

import numpy as np

from errpipe import jsonfile
from errpipe.domain.error_model import ComponentModel, ErrorModel, FittedParameter, FittedTerm
from errpipe.fitting import pooling
from errpipe.verbs.fleet_processes import Task

MIRRORED = (6.0, 2.0)  # spreads that a machine of the other sign is away from its type, at least, and turned, at most
MIN_SPREAD_MACHINES = 5  # machines of a type below which no spread between them is known
NARROWEST = 1e-6  # of a parameter's size: standard deviation of a prior where machines do not differ
UNLIMITED = 1e12  # variance inflation that is allowed where every parameter has a prior


def responses(models: Mapping[str, ErrorModel], min_machines: int = pooling.MIN_MACHINES) -> dict[str, dict[str, Any]]:
    """Pooled parameters of each response over the machines of a type, from their models by name.

    Mean and spread (covariance between machines) of the parameters where at least so many machines have them.
    """
    out: dict[str, dict[str, Any]] = {}
    for component in dict.fromkeys(c.component for m in models.values() for c in m.components):
        names, keys, estimates, covariances = _estimates(models, component)
        pooled = pooling.pooled(estimates, covariances, min_machines)
        out[component] = {
            "parameters": list(keys),
            "machines": names,
            "alike": [[names[k] for k in group] for group in pooling.homogeneous_groups(estimates, covariances)],
            "mirrored": _mirrored(names, estimates, covariances),
        }
        if pooled is not None:
            out[component] |= {"mean": pooled.mean.tolist(), "spread": pooled.spread.tolist()}
    return out


def shrink_to_type(models: dict[str, ErrorModel], component: str, response: dict[str, Any]) -> None:
    """Shrink the models of a type towards its mean (`response`: of `responses`), which then holds their parameters."""
    if "mean" not in response:
        return
    names, _, estimates, covariances = _estimates(models, component)
    pool = pooling.Pool(np.array(response["mean"]), np.array(response["spread"]), len(names))
    response["pooled"] = {}
    for name, estimate, covariance in zip(names, estimates, covariances, strict=True):
        mean, spread = pool.shrunk(estimate, covariance)
        response["pooled"][name] = mean.tolist()
        models[name] = with_parameters(models[name], component, mean, spread)


def tasks_with_priors(
    tasks: Sequence[Task],
    undetermined: Container[str],
    results: Mapping[str, Mapping[str, Any]],
    models: Mapping[str, ErrorModel | None],
    types: Mapping[str, str],
) -> list[Task]:
    """Tasks of the machines with unidentifiable parameters, with priors: mean and spread of their type.

    undetermined: names of these machines; results, models, types: of all machines by name. A machine whose type is
    not known by enough others has no task. Parameters inside a term (time constants) are those of the type.
    """
    out = []
    for pipeline, name, sets, folder in tasks:
        same_type = {n: m for n, kind in types.items() if kind == types[name] and (m := models[n]) is not None}
        known = responses(same_type, pooling.MIN_LENDERS) if name in undetermined else {}
        if known and all("mean" in response for response in known.values()):
            fits, keys = results[next(iter(same_type))]["fits"], []
            for stage in dict.fromkeys(fits.values()):
                of_stage = [_component(n, r) for n, r in known.items() if fits.get(n) == stage]
                components = jsonfile.dumps(of_stage, indent=None).strip()
                keys += [f"{stage}.components={components}", f"{stage}.most_inflation={UNLIMITED:g}"]
            out.append((pipeline, name, [*sets, *keys], folder))
    return out


def _component(name: str, response: Mapping[str, Any]) -> dict[str, Any]:
    """One response of a type as a fit declares it: a prior for each linear parameter, the others fixed."""
    from errpipe.fitting.spec import ComponentSpec  # every term is loaded: only where one borrows

    pool = pooling.Pool(np.array(response["mean"]), np.array(response["spread"]), len(response["machines"]))
    spreads = pool.of_a_further_machine()
    terms: dict[str, dict[str, float]] = {}
    known: dict[tuple[str, str], float] = {}
    for key, value, spread in zip(response["parameters"], response["mean"], spreads, strict=True):
        term, _, parameter = key.rpartition(".")
        terms.setdefault(term, {})[parameter] = value
        known[term, parameter] = max(float(spread), NARROWEST * (1.0 + abs(value)))
    declared = {term: json.loads(term) for term in terms}
    bound = ComponentSpec.model_validate({"component": name, "terms": list(declared.values())}).terms
    priors: list[dict[str, Any]] = []
    for (text, fields), term in zip(declared.items(), bound, strict=True):
        linear = {p.name for p in term.linear()}
        where = {key: value for key, value in fields.items() if key not in ("term", "fixed")}
        for parameter, value in terms[text].items():
            about = {"term": fields["term"], "where": where, "parameter": parameter}
            if parameter in linear:
                priors.append(about | {"value": value, "spread": known[text, parameter]})
            else:
                fields["fixed"] = fields.get("fixed", {}) | {parameter: value}
    return {"component": name, "terms": list(declared.values()), "priors": priors}


def _mirrored(names: Sequence[str], estimates: Sequence[np.ndarray], covariances: Sequence[np.ndarray]) -> list[str]:
    """Machines whose parameters lie far from those of the others, and with the other sign among them."""
    if len(names) < MIN_SPREAD_MACHINES:
        return []
    values = np.array(estimates)
    centre = np.median(values, axis=0)
    errors = np.sqrt(np.median([np.diag(c) for c in covariances], axis=0))
    spread = np.maximum(1.4826 * np.median(np.abs(values - centre), axis=0), errors)  # 1.4826: of normal deviates
    away, turned = (
        np.sqrt(np.mean(((sign * values - centre) / np.where(spread > 0.0, spread, np.inf)) ** 2, axis=1))
        for sign in (1.0, -1.0)
    )
    return [n for n, a, t in zip(names, away, turned, strict=True) if a > MIRRORED[0] and t < MIRRORED[1]]


def _estimates(
    models: Mapping[str, ErrorModel], component: str
) -> tuple[list[str], tuple[str, ...], list[np.ndarray], list[np.ndarray]]:
    """Estimates and covariances of the machines whose model of a response has the commonest parameters."""
    parts = {n: c for n, m in models.items() for c in m.components if c.component == component and c.parameter_names}
    names = {n: [(jsonfile.dumps(t.term, indent=None).strip(), p.name) for t, p in _free(c)] for n, c in parts.items()}
    keys_of = {n: tuple(f"{term}.{name}" for term, name in of) for n, of in names.items()}
    keys = Counter(keys_of.values()).most_common(1)[0][0] if parts else ()
    same = {n: c for n, c in parts.items() if keys_of[n] == keys}
    values = [np.array([p.value for _, p in _free(c)]) for c in same.values()]
    return list(same), keys, values, [np.array(c.covariance) for c in same.values()]


def _free(component: ComponentModel) -> list[tuple[FittedTerm, FittedParameter]]:
    """The parameters that were solved for, each with its term, in the order of the covariance."""
    return [(t, p) for t in component.terms for p in t.parameters if p.name not in t.term.get("fixed", {})]


def with_parameters(model: ErrorModel, component: str, values: np.ndarray, covariance: np.ndarray) -> ErrorModel:
    """The model with other parameters of one response; 95 % intervals follow from the covariance."""
    spread, parts, at = np.sqrt(np.maximum(np.diag(covariance), 0.0)), [], 0
    for c in model.components:
        if c.component != component:
            parts.append(c)
            continue
        terms = []
        for term in c.terms:
            parameters = []
            for p in term.parameters:
                if p.name in term.term.get("fixed", {}):
                    parameters.append(p)
                    continue
                v, s = float(values[at]), float(spread[at])
                changed = {"value": v, "standard_error": s, "ci95": (v - 1.96 * s, v + 1.96 * s)}
                parameters.append(p.model_copy(update=changed | {"note": "drawn towards the machines of its type"}))
                at += 1
            terms.append(term.model_copy(update={"parameters": tuple(parameters)}))
        parts.append(c.model_copy(update={"terms": tuple(terms)}))
    return model.model_copy(update={"components": tuple(parts)})
