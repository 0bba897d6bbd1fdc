"""The lines of the confusion benchmark as Markdown: shares against goals, who was taken for whom, what went wrong."""

import collections

import numpy as np

__all__ = ["GOALS", "report"]

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
