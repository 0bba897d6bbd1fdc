"""What was found against what was hidden: plain numbers and words in, one flat dictionary a case out.

"Named right": the first finding's effect is the hidden one by class; with two hidden effects, the findings are these
two in any order and no other. Where nothing is hidden: no firm name. "Place right": given a right name. Held-out /
floor: mean squares over all held-out outputs, each over its true noise variance.
"""

import numpy as np

__all__ = ["HYSTERETIC", "allowed_names", "outcome", "parameter_scores", "same_place"]

HYSTERETIC = ("coulomb_friction", "bouc_wen_hysteresis", "slack_in_hysteresis")
"""Effects whose parameters are asked to 10 %; all others to 5 %."""


def allowed_names(effect, *, n_dofs, n_outputs, sensor_kind, velocity_reverses):
    """Names that count as right for a hidden effect: no data of this kind could tell them apart."""
    names = {effect}
    if n_dofs == 1 and effect in ("input_gain", "sensor_gain"):
        names |= {"input_gain", "sensor_gain"}
    if effect == "coulomb_friction" and not velocity_reverses:
        names.add("constant_force")
    if effect == "constant_force" and n_outputs == 1 and sensor_kind == "displacement":
        names.add("sensor_bias")  # of one displacement a static force is an offset
    return names


def same_place(found, hidden, effect):
    """Whether two names mean one place.

    A force on degree of freedom 0 and element 0 are one; the order of a pair does not matter; a gain that sits at the
    input may, for one degree of freedom, be found at the output.
    """
    words, numbers = ({place.split("_")[i] for place in (found, hidden)} for i in (0, 1))
    if effect in ("input_gain", "sensor_gain", "constant_force") and len(words) == 2 and words & {"input", "output"}:
        return numbers == {"0"}
    return _parts(found) == _parts(hidden)


def _parts(place):
    parts = [part.split(" ")[0] for part in place.split("-")]
    return {"element_0" if part == "dof_0" else part for part in parts}


def outcome(case, diagnosis, *, seconds):
    """One line: what was hidden, what was found, how well.

    Args:
        case: A `HiddenCase`.
        diagnosis: With `.status`, `.findings`, `.gap_after` as in the public table.
        seconds: CPU time of the diagnosis.
    """
    setting = _setting(case)
    findings = list(diagnosis.findings)
    wanted = [(allowed_names(e.effect, **setting), e) for e in case.effects]
    pairs = _matched(findings, wanted)
    complete = len(pairs) == len(wanted)
    right = complete and len(findings) == len(wanted) if len(wanted) > 1 else complete
    firm = diagnosis.status == "named"
    if not wanted:
        right = not firm
    variance = np.array([record.noise_variance for record in case.held_out])
    after = np.asarray(diagnosis.gap_after, dtype=float) ** 2
    return {
        **describe(case),
        "status": diagnosis.status,
        "found": [[f.effect, f.where] for f in findings],
        "named_right": bool(right),
        "surplus": len(findings) - len(pairs),
        "place_right": bool(right and all(same_place(f.where, e.place, e.effect) for f, e in pairs)),
        "firm": firm,
        "held_out_to_floor": float(np.mean(after / variance)),
        "floor_to_truth": _floor_ratio(case, diagnosis),
        "parameters": [score for f, e in pairs for score in parameter_scores(f, e)] if right else [],
        "seconds": float(seconds),
    }


def describe(case):
    """The truth in short."""
    return {
        "kind": case.kind,
        "seed": case.seed,
        "hidden": [[e.effect, e.place] for e in case.effects],
        "gap_to_noise": [round(gap, 3) for gap in case.gap_to_noise],
        "n_dofs": _setting(case)["n_dofs"],
        "n_outputs": _setting(case)["n_outputs"],
        "sensor_kind": _setting(case)["sensor_kind"],
        "n_samples": sum(len(r.outputs) for r in case.fit + case.held_out),
        "n_fit": len(case.fit),
    }


def _setting(case):
    nominal = case.nominal
    n_states = len(nominal.A) if hasattr(nominal, "A") else 2
    return {
        "n_dofs": len(nominal.masses) if hasattr(nominal, "masses") else n_states // 2,
        "n_outputs": case.fit[0].outputs.shape[1],
        "sensor_kind": getattr(nominal, "sensor_kind", "velocity"),
        "velocity_reverses": case.velocity_reverses,
    }


def _matched(findings, wanted):
    """(finding, hidden effect) pairs: with one hidden effect the first finding, with more any of them, each once."""
    if len(wanted) == 1:
        names, effect = wanted[0]
        return [(findings[0], effect)] if findings and findings[0].effect in names else []
    left, pairs = list(findings), []
    for names, effect in wanted:
        for finding in left:
            if finding.effect in names:
                pairs.append((finding, effect))
                left.remove(finding)
                break
    return pairs


def parameter_scores(finding, hidden):
    """[{name, truth, value, std, relative_error, tolerance, deviations}] of the parameters that data determine.

    Of a gap spring these are k_out - k_in and the gap, for a linear spring beside it is a wrong parameter.
    """
    if finding.effect != hidden.effect:
        return []
    found = {p.name: (float(p.value), float(p.std)) for p in finding.parameters}
    truth = dict(hidden.parameters)
    if hidden.effect == "gap_spring" and {"k_in", "k_out"} <= set(found):
        (k_in, std_in), (k_out, std_out) = found.pop("k_in"), found.pop("k_out")
        found["k_out - k_in"] = k_out - k_in, float(np.hypot(std_in, std_out))
        truth["k_out - k_in"] = truth.pop("k_out") - truth.pop("k_in")
    if hidden.effect == "power_law_flow":
        truth = {"exponent": truth["exponent"]}  # the coefficient is counted at another level
    tolerance = 0.1 if hidden.effect in HYSTERETIC else 0.05
    scores = []
    for name, true in truth.items():
        if name in found:
            value, std = found[name]
            scores.append(
                {
                    "name": f"{hidden.effect}.{name}",
                    "truth": true,
                    "value": value,
                    "std": std,
                    "relative_error": abs(value - true) / abs(true),
                    "tolerance": tolerance,
                    "deviations": abs(value - true) / std if std > 0 else None,
                }
            )
    return scores


def _floor_ratio(case, diagnosis):
    """Estimated over true noise variance, one number a record and output; empty where the rows do not match."""
    estimated = np.atleast_2d(np.asarray(diagnosis.noise_floor.variance, dtype=float))
    true = np.array([record.noise_variance for record in case.fit + case.held_out])
    return (estimated / true).round(4).ravel().tolist() if estimated.shape == true.shape else []
