"""Hidden cases and the product: model and records through public names only, and what was found against the truth.

`outcome` gives one flat dictionary of plain numbers and words a case; `report` writes such lines as Markdown: shares
against goals, who was taken for whom, what went wrong.

"Named right": the first finding's effect is the hidden one by class; with two hidden effects, the findings are these
two in any order and no other. Where nothing is hidden: no firm name. "Place right": given a right name. Held-out /
floor: mean squares over all held-out outputs, each over its true noise variance.
"""

import collections
import inspect

import control
import numpy as np

import modal
import okid


def model_of(case):
    """The wrong linear model: a structure, a shaft, a tank or a state space."""
    nominal = case.nominal
    kind = type(nominal).__name__
    if kind == "NominalChain":
        return modal.StructuralModel.chain(
            nominal.masses,
            nominal.stiffnesses,
            nominal.dampings,
            force_dofs=nominal.force_dofs,
            sensor_dofs=nominal.sensor_dofs,
            sensor_kind=nominal.sensor_kind,
        )
    if kind == "NominalStateSpace":
        return control.StateSpace(nominal.A, nominal.B, nominal.C, nominal.D)
    if nominal.is_flow:
        return control.StateSpace([[-nominal.b / nominal.J]], [[nominal.kt / nominal.J]], [[1.0]], [[0.0]])
    return modal.StructuralModel(
        [[nominal.J]],
        [[nominal.b]],
        [[0.0]],
        force_map=[[nominal.kt]],
        sensor_map=[[1.0]],
        sensor_kind="velocity",
        length_unit="rad",
        force_unit="N m",
    )


def options_of(case, diagnose):
    """What a state space does not say of itself and the user must."""
    sensor_kind = getattr(case.nominal, "sensor_kind", "displacement")
    if type(case.nominal).__name__ == "NominalChain" or "sensor_kind" not in inspect.signature(diagnose).parameters:
        return {}
    is_state_space = type(case.nominal).__name__ == "NominalStateSpace" or case.nominal.is_flow
    return {"sensor_kind": sensor_kind} if is_state_space else {}


def record_of(hidden):
    """One record; the noise is not told."""
    return okid.Record(hidden.inputs, hidden.outputs, hidden.dt, input_hold=hidden.hold, name=hidden.name)


def records_of(case):
    """Records to fit and records held out."""
    return [record_of(hidden) for hidden in case.fit], [record_of(hidden) for hidden in case.held_out]


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


GOALS = {
    "1dof_displacement": (0.98, 0.99, 4.0),
    "1dof_accelerometer": (0.96, 0.95, 4.0),
    "3dof_displacement": (0.97, 0.99, 10.0),
    "3dof_accelerometers": (0.96, 0.95, 10.0),
    "state_space": (0.95, 0.95, 10.0),
    "motor_propeller": (1.0, 1.0, 4.0),
    "motor_friction": (0.9, 0.9, 4.0),
    "tank": (0.95, 0.95, 4.0),
    "two_effects": (0.9, 0.9, 20.0),
    "weak_effects": (0.95, 0.95, 10.0),
    "none": (1.0, 1.0, 10.0),
}
"""Share named right, share of these with the right place, CPU seconds a case; "tank" has no goal of its own."""
LEAST_FIRM, MOST_LEFT = 0.85, 1.05


def report(lines, *, command=""):
    """Markdown of all tables; `lines` as `hidden_scoring.outcome` makes them, or {"error": ...} where it raised."""
    kinds = [kind for kind in GOALS if any(line["kind"] == kind for line in lines)]
    parts = [
        *(["`" + command + "`", ""] if command else []),
        summary(lines, kinds),
        "",
        "### Who is taken for whom",
        "",
        confusion(lines),
        "",
        "### Parameters",
        "",
        parameters(lines),
        "",
        "### The estimated noise floor over the true one",
        "",
        floors(lines, kinds),
        "",
        "### Cases that are not right",
        "",
        wrong(lines),
    ]
    return "\n".join(parts) + "\n"


def summary(lines, kinds):
    """One line a kind; goals in brackets."""
    rows = [
        "| kind | cases | named right | place right | firm | firm, wrong | left / floor (90 %) | CPU s (90 %), most |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for kind in kinds:
        all_of_kind = [line for line in lines if line["kind"] == kind]
        own = [line for line in all_of_kind if "error" not in line]
        name_goal, place_goal, cpu_goal = GOALS[kind]
        hidden = [line for line in own if line["hidden"]]
        right = sum(line["named_right"] for line in own)
        right_hidden = [line for line in hidden if line["named_right"]]
        placed = sum(line["place_right"] for line in right_hidden)
        firm = [line for line in own if line["firm"]]
        left = [line["held_out_to_floor"] for line in own]
        seconds = [line["seconds"] for line in own]
        rows.append(
            f"| {kind} | {len(all_of_kind)} | {_share(right, len(all_of_kind))} ({_percent(name_goal)}) "
            f"| {_share(placed, len(right_hidden))} ({_percent(place_goal)}) "
            f"| {_share(sum(line['firm'] for line in hidden), len(hidden))} ({_percent(LEAST_FIRM)}) "
            f"| {sum(not (line['named_right'] and line['place_right']) for line in firm)} of {len(firm)} (0) "
            f"| {_quantiles(left, '.3f')} ({MOST_LEFT}) "
            f"| {_quantiles(seconds, '.1f')}, {_most(seconds)} ({cpu_goal:g}) |"
        )
    return "\n".join(rows)


def confusion(lines):
    """Hidden against found (first finding, one hidden effect), a line a hidden effect."""
    counts = collections.Counter()
    for line in lines:
        if "error" not in line and len(line["hidden"]) <= 1:
            hidden = line["hidden"][0][0] if line["hidden"] else "none"
            found = line["found"][0][0] if line["found"] else "none"
            mark = "" if line["firm"] or found == "none" else " (guess)"
            counts[hidden, found + mark] += 1
    rows = ["| hidden | cases | found |", "|---|---|---|"]
    for hidden in sorted({h for h, _ in counts}):
        found = sorted(((f, n) for (h, f), n in counts.items() if h == hidden), key=lambda pair: -pair[1])
        rows.append(f"| {hidden} | {sum(n for _, n in found)} | {', '.join(f'{f} {n}' for f, n in found)} |")
    return "\n".join(rows)


def parameters(lines):
    """Share within tolerance, and inside the interval of one and of two deviations, a line a parameter and in all."""
    scores = collections.defaultdict(list)
    for line in lines:
        for score in line.get("parameters", []):
            scores[score["name"]].append(score)
    rows = [
        "| parameter | cases | within 5 % (loops: 10 %) | error, median | in 1 std (68 %) | in 1.96 std (95 %) |",
        "|---|---|---|---|---|---|",
    ]
    everything = [score for own in scores.values() for score in own]
    for name, own in [*sorted(scores.items()), ("all", everything)]:
        if own:
            off = np.array([score["relative_error"] for score in own])
            close = sum(score["relative_error"] <= score["tolerance"] for score in own)
            known = np.array([score["deviations"] for score in own if score["deviations"] is not None])
            rows.append(
                f"| {name} | {len(own)} | {_share(close, len(own))} | {100 * np.median(off):.2g} % "
                f"| {_share(int(np.sum(known <= 1)), len(known))} | {_share(int(np.sum(known <= 1.96)), len(known))} |"
            )
    return "\n".join(rows)


def floors(lines, kinds):
    """Quantiles of the ratio, a line a kind."""
    rows = ["| kind | 10 % | median | 90 % | above 1.25 |", "|---|---|---|---|---|"]
    for kind in kinds:
        ratios = np.array([r for line in lines if line["kind"] == kind for r in line.get("floor_to_truth", [])])
        if ratios.size:
            low, middle, high = np.quantile(ratios, [0.1, 0.5, 0.9])
            high_share = _share(int((ratios > 1.25).sum()), ratios.size)
            rows.append(f"| {kind} | {low:.2f} | {middle:.2f} | {high:.2f} | {high_share} |")
    return "\n".join(rows)


def wrong(lines):
    """Every case whose name or place is wrong, or that raised."""
    rows = [
        "| kind | seed | hidden | found | status | held-out / floor | gap / noise |",
        "|---|---|---|---|---|---|---|",
    ]
    for line in sorted(lines, key=lambda line: (line["kind"], line["seed"])):
        gaps = ", ".join(f"{gap:.2g}" for gap in line.get("gap_to_noise", []))
        case = f"| {line['kind']} | {line['seed']} | {_named(line['hidden'])}"
        if "error" in line:
            rows.append(f"{case} | {line['error']} | error | | {gaps} |")
        elif not line["named_right"] or (line["hidden"] and not line["place_right"]):
            left = f"{line['held_out_to_floor']:.3g}"
            rows.append(f"{case} | {_named(line['found'])} | {line['status']} | {left} | {gaps} |")
    return "\n".join(rows) if len(rows) > 2 else "None."


def _named(pairs):
    return ", ".join(f"{effect} at {place}" for effect, place in pairs) or "nothing"


def _share(part, whole):
    return f"{part} of {whole}, {100 * part / whole:.1f} %" if whole else "-"


def _percent(share):
    return f"{100 * share:g} %"


def _quantiles(values, form):
    if not values:
        return "-"
    return f"{np.median(values):{form}} ({np.quantile(values, 0.9):{form}})"


def _most(values):
    return f"{max(values):.1f}" if values else "-"
