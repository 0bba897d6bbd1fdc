"""The leaderboard in Markdown, and what is wanted of ours beside what was measured: met or not, from the same figures.

Bold marks the best of a column, whoever it is.
"""

import re

import numpy as np
from stamps import write_figures

WANTED_FITS = {"cd_player_arm": 0.83, "flexible_robot": 0.86, "robot_arm": 0.94}
WANTED_SECONDS = {"identify, 12 000 x 4": 3.0, "identify, 8500 x 30": 8.0}
WANTED_RATIOS = {"observer, 16x2 / 1e5": ("slicot", 4.0), "diagram, 8x2 / 2e4": ("pyoma2", 20.0)}
BEHIND = 0.02


def random_goals(rows):
    """(what, wanted, measured, met) for ours at its defaults, on all systems."""
    own = next((figures for name, setting, figures in rows if (name, setting) == ("ours", "defaults")), None)
    if own is None or own["failed"] == own["models"]:
        return []
    goals = [
        ("failed or diverged", "0", str(own["failed"] + own["diverged"]), own["failed"] + own["diverged"] == 0),
        ("modes found", ">= 97 %", f"{100 * own['found']:.1f} %", own["found"] >= 0.97),
        ("false system modes", "0", str(own["false"]), own["false"] == 0),
        _ratio("frequency", own["frequency"], 1.1),
        _ratio("damping", own["damping_ratio"], 1.2),
        (
            "systems within 0.01 of the ceiling",
            ">= 90 %",
            f"{own['near_ceiling']} of {own['systems']}",
            own["near_ceiling"] >= 0.9 * own["systems"],
        ),
    ]
    for key, words in (("frequency", "frequency"), ("damping_ratio", "damping")):
        share, n = own["coverage"][key]["share"], own["coverage"][key]["n"]
        measured = "no interval" if share is None else f"{100 * share:.1f} % of {n}"
        met = share is not None and 0.93 <= share <= 0.97 and n >= 1000
        goals.append((f"95 % intervals of {words} that hold the truth", "93 to 97 % of >= 1000", measured, met))
    return goals


def _ratio(words, ratio, limit):
    return f"RMSE / bound, pooled, {words}", f"<= {limit}", pooled(ratio), ratio["rms"] <= limit


def pooled(ratio):
    """The pooled rms of error / bound, with its standard error by systems where there are several."""
    return f"{ratio['rms']:.2f}" + (f" ± {ratio['std']:.2f}" if ratio["std"] is not None else "")


def record_goals(rows, peers):
    goals = []
    for row in rows:
        if "fit" not in row["ours"]:
            goals.append((f"{row['name']}: a model", "", "failed", False))
            continue
        fit = row["ours"]["fit"]
        best = max((row[name]["fit"] for name in peers if "fit" in row.get(name, {})), default=None)
        if best is not None and fit < best - BEHIND:
            goals.append((f"{row['name']}: fit", f">= {best - BEHIND:.3f} (best peer - 0.02)", f"{fit:.3f}", False))
        if row["name"] in WANTED_FITS:
            wanted = WANTED_FITS[row["name"]]
            goals.append((f"{row['name']}: fit", f">= {wanted}", f"{fit:.3f}", fit >= wanted))
        if row["ours"]["radius"] >= 1.0:
            goals.append((f"{row['name']}: spectral radius", "< 1", f"{row['ours']['radius']:.6f}", False))
    behind = sum("best peer" in goal[1] for goal in goals)
    return [("records behind the best peer by more than 0.02", "0", f"{behind} of {len(rows)}", behind == 0), *goals]


def cost_goals(lines):
    goals = []
    for line, seconds in lines.items():
        least = {name: min(times) for name, times in seconds.items() if name != "failures" and times}
        if line in WANTED_SECONDS and "ours" in least:
            wanted = WANTED_SECONDS[line]
            goals.append((line, f"<= {wanted:g} s", f"{least['ours']:.2f} s", least["ours"] <= wanted))
        if line in WANTED_RATIOS and {"ours", WANTED_RATIOS[line][0]} <= set(least):
            peer, wanted = WANTED_RATIOS[line]
            ratio = least[peer] / least["ours"]
            goals.append((f"{line}, against {peer}", f">= {wanted:g} times", f"{ratio:.1f}", ratio >= wanted))
    return goals


TITLE = "# Leaderboard"
WHO = "Contenders"
ERRORS = ("frequency", "damping_ratio")
ABOUT = (
    "Written by a command, not by hand; bold marks the best of a column, whoever it is. CPU times are of one "
    "BLAS thread; ratios decide, seconds are a guide."
)
ABOUT_RANDOM = (
    "2 to 8 modes, the first two 2 to 8 % apart, the last one 2 to 10 times weaker, 1 to 3 coloured inputs, 1 to 6 "
    "outputs, C B != 0, D != 0, unknown initial state, 1 to 10 % white noise, 3000 to 6000 rows "
    "(`tests/reference/random_problems.py`). RMSE over the Cramer-Rao bound (`tests/reference/crb.py`): root of the "
    "mean of (error / bound)^2 over all found modes, ± its standard error by systems, in brackets the median of the "
    "systems' own (biased low); errors beyond 9 bounds count as missed there, and are counted. Within reach: three "
    "bounds of its frequency fit into the tolerance. A peer has no verdict: each of its stable poles with less than "
    "20 % damping is a claim. Damping wrong: off by more than 50 % and 0.004, not marked as unresolved. Ceiling: the "
    "fit of the true system on the same held-out rows; a system counts when the mean over its realisations is within "
    "0.01 (a failure or a divergence loses it). CPU: median of one identification."
)
ABOUT_SWEEP = (
    "None of these systems is among the random problems below. Score: rms of error / bound over frequency and damping "
    "of every true mode, 9 where it is missed or farther off; the best of each (bold) is what the peer runs with below."
)
ABOUT_RECORDS = (
    "Continued fit: one free run on rows that nobody was trained on (the last quarter; with several records the last "
    "record), less the means of the training rows, initial state from earlier rows; the same rows, band and rule for "
    "all. Orders of the peers are chosen on a held-out part of the training rows (`records_board.py`)."
)
ABOUT_COST = (
    "Outputs x inputs / samples, or samples x channels; least of the rounds, each in its own process; what is timed "
    "stands in `cost_board.py`."
)


def document(sections):
    """All of it for the terminal: {title of a section: its text}."""
    parts = [TITLE, ABOUT, *(f"## {title}\n\n{text}" for title, text in sections.items())]
    return re.sub(r"\n{3,}", "\n\n", "\n\n".join(parts)) + "\n"


def write_document(page, sections, commands):
    """Each section into the place of the last one of its kind; what did not run stays as it is."""
    text = page.read_text(encoding="utf-8")
    contenders = f"## {WHO}\n\n{sections[WHO]}\n\n"
    text = re.sub(rf"## {WHO}\n.*?(?=## )", lambda _: contenders, text, flags=re.DOTALL)
    page.write_text(text, encoding="utf-8")
    for title, (part, command) in commands.items():
        write_figures(page, command, re.sub(r"\n{3,}", "\n\n", sections[title]), key=f"--parts {part} ")


def settings_list(contenders):
    lines = []
    for name, (module, version) in contenders.items():
        first = module.__doc__.strip().splitlines()[0]
        lines.append(f"- **{name}**{f' ({version})' if version else ''}: {first}")
        lines += [f"    - {setting}: {words}" for setting, words in module.SETTINGS.items()]
    return "\n".join(lines)


# --- random problems -------------------------------------------------------------------------------------------------


def random_table(rows, *, first_seed, realisations):
    n_systems = max(figures["systems"] for _, _, figures in rows)
    seeds = f"seeds {first_seed} to {first_seed + n_systems - 1}"
    columns = {
        "contender": [f"{name}, {setting}" for name, setting, _ in rows],
        "systems": [str(figures["systems"]) for _, _, figures in rows],
        "found %": _column(rows, lambda f: 100 * f["found"], "{:.1f}", best=max),
        "within reach, found %": _column(rows, lambda f: 100 * f["found_in_reach"], "{:.1f}", best=max),
        "false": _column(rows, lambda f: f["false"] if f["failed"] < f["models"] else None, "{:d}"),
        "frequency: RMSE / bound": _ratio_column(rows, "frequency"),
        "damping": _ratio_column(rows, "damping_ratio"),
        "beyond 9 bounds": [_beyond(figures) for _, _, figures in rows],
        "damping wrong": _column(rows, lambda f: f["wrong_damping"] if f["failed"] < f["models"] else None, "{:d}"),
        "systems within 0.01 of the ceiling": _column(rows, lambda f: f["near_ceiling"], "{:d}"),
        "unstable / fit < 0": [f"{f['unstable']} / {f['diverged']}" for _, _, f in rows],
        "failed": [f"{f['failed']} of {f['models']}" if f["failed"] else "0" for _, _, f in rows],
        "CPU s": _column(rows, lambda f: f["cpu"], "{:.3g}"),
    }
    lines = [
        f"{n_systems} systems ({seeds}), {realisations} noise realisations each. {ABOUT_RANDOM}",
        "",
        _markdown(columns),
    ]
    lines += ["", *_goals(random_goals(rows)), *_interval_lines(rows), *_failure_lines(rows)]
    return "\n".join(lines)


def _column(rows, value, form, best=None):
    values = [value(figures) for _, _, figures in rows]
    known = [v for v in values if v is not None and np.isfinite(v)]
    top = best(known) if best and known else None
    return ["-" if v is None else _bold(form.format(v), marked=v == top) for v in values]


def _ratio_column(rows, key):
    ratios = [figures[key] for _, _, figures in rows]
    top = min((r["rms"] for r in ratios if r), default=None)
    return ["-" if r is None else f"{_bold(pooled(r), marked=r['rms'] == top)} ({r['median']:.2f})" for r in ratios]


def _beyond(figures):
    return " / ".join("-" if figures[key] is None else str(figures[key]["beyond"]) for key in ERRORS)


def _interval_lines(rows):
    lines = []
    for name, setting, figures in rows:
        if name != "ours":
            continue
        parts = []
        for key, words in (("frequency", "frequency"), ("damping_ratio", "damping")):
            own = figures["coverage"][key]
            share = "no interval" if own["share"] is None else f"{100 * own['share']:.1f} % of {own['n']}"
            parts.append(f"{words} {share}" + (f" ({own['none']} modes without one)" if own["none"] else ""))
        who = f"ours, {setting}, {figures['systems']} systems"
        certain = f"{100 * figures['certain']:.1f} % of the true modes were found and called system"
        lines.append(f"95 % intervals of {who}, that hold the truth: {'; '.join(parts)}. There {certain}.")
        lines.append("")
    return lines


def _failure_lines(rows):
    failed = [(name, setting, figures) for name, setting, figures in rows if figures["failed"]]
    return [f"- {name}, {setting}: {'; '.join(figures['why'])}" for name, setting, figures in failed]


# --- settings of the peers -------------------------------------------------------------------------------------------


def sweep_table(rows, *, n_systems, first_seed, realisations):
    """`rows`: (contender, setting, figures with "score"); the best of a form is marked, and should be the one used."""
    seeds = f"seeds {first_seed} to {first_seed + n_systems - 1}"
    best = {}
    for name, form, _, figures in rows:
        best[name, form] = min(best.get((name, form), np.inf), round(figures["score"], 2))
    columns = {
        "contender": [f"{name}, {setting}" for name, _, setting, _ in rows],
        "score": [
            _bold(f"{f['score']:.2f}", marked=round(f["score"], 2) == best[name, form]) for name, form, _, f in rows
        ],
        "found %": [f"{100 * f['found']:.1f}" for *_, f in rows],
        "frequency: RMSE / bound": ["-" if f["frequency"] is None else pooled(f["frequency"]) for *_, f in rows],
        "damping": ["-" if f["damping_ratio"] is None else pooled(f["damping_ratio"]) for *_, f in rows],
        "failed": [f"{f['failed']} of {f['models']}" if f["failed"] else "0" for *_, f in rows],
        "CPU s": ["-" if f["cpu"] is None else f"{f['cpu']:.3g}" for *_, f in rows],
    }
    about = f"{n_systems} systems of building ({seeds}), {realisations} noise realisations each. {ABOUT_SWEEP}"
    return "\n".join([about, "", _markdown(columns)])


# --- measured records ------------------------------------------------------------------------------------------------


def records_table(rows, left_out):
    peers = [key for key in ("slicot", "sippy") if any(key in row for row in rows)]
    columns = {
        "record": [row["name"] for row in rows],
        "training + scored rows, inputs, outputs": [
            f"{' + '.join(map(str, row['n_samples']))}, {row['n_inputs']}, {row['n_outputs']}" for row in rows
        ],
        "decimated by": [str(row["factor"]) for row in rows],
        "ours: fit (order)": [_record_cell(row, "ours", peers) for row in rows],
        **{f"{peer}: fit (order)": [_record_cell(row, peer, peers) for row in rows] for peer in peers},
        "ours less the best peer": [_difference(row, peers) for row in rows],
        "ours: cross-validated": [_own(row, "own_fit", "{:.3f}") for row in rows],
        "system modes": [str(len(row["ours"].get("system_modes", []))) for row in rows],
        "warnings": [_own(row, "warnings", "{:d}") for row in rows],
        "CPU s": [_own(row, "cpu", "{:.1f}") for row in rows],
    }
    lines = [
        ABOUT_RECORDS,
        "",
        _markdown(columns),
        "",
        *_goals(record_goals(rows, peers)),
        *(
            f"- {row['name']}, {who}: {row[who]['failure']}"
            for row in rows
            for who in ("ours", *peers)
            if "failure" in row.get(who, {})
        ),
        *(f"- {name}: left out, {why}" for name, why in left_out.items()),
    ]
    return "\n".join(lines)


def _record_cell(row, who, peers):
    if "failure" in row.get(who, {"failure": ""}):
        return "failed" if who in row else "not run"
    own = row[who]
    best = max((row[name]["fit"] for name in ("ours", *peers) if "fit" in row.get(name, {})), default=None)
    text = f"{own['fit']:.3f}" if own["fit"] > -9.9 else "diverged"
    return f"{_bold(text, marked=own['fit'] == best)} ({own['order']})"


def _difference(row, peers):
    fits = [row[name]["fit"] for name in peers if "fit" in row.get(name, {})]
    if "fit" not in row["ours"] or not fits:
        return "-"
    return f"{row['ours']['fit'] - max(fits):+.3f}" if max(fits) > -9.9 else "peers diverged"


def _own(row, key, form):
    return form.format(row["ours"][key]) if key in row["ours"] else "-"


# --- cost ------------------------------------------------------------------------------------------------------------


def cost_table(lines):
    rows = []
    for line, seconds in lines.items():
        least = {name: min(times) for name, times in seconds.items() if name != "failures" and times}
        ours = least.get("ours")
        for name, value in least.items():
            ratio = f"{value / ours:.1f}" if ours and not name.startswith("ours") else ""
            rows.append((line, name, f"{value:.3g}", ratio, str(len(seconds[name]))))
        rows += [(line, name, f"failed: {why}", "", "") for name, why in seconds.get("failures", {}).items()]
    heads = ("what", "contender", "CPU s", "times ours", "rounds")
    columns = dict(zip(heads, map(list, zip(*rows, strict=True)), strict=False))
    if not rows:
        return "not run"
    return "\n".join([ABOUT_COST, "", _markdown(columns), "", *_goals(cost_goals(lines))])


# --- Markdown --------------------------------------------------------------------------------------------------------


def _goals(goals):
    """Wanted of ours, as a table, with an empty line after it."""
    if not goals:
        return []
    what, wanted, measured, met = map(list, zip(*goals, strict=True))
    columns = {"wanted of ours": what, "limit": wanted, "measured": measured}
    return [_markdown({**columns, "met": ["yes" if one else "**no**" for one in met]}), ""]


def _bold(text, *, marked):
    return f"**{text}**" if marked else text


def _markdown(columns):
    head = "| " + " | ".join(columns) + " |"
    rule = "|" + "---|" * len(columns)
    body = ["| " + " | ".join(cells) + " |" for cells in zip(*columns.values(), strict=True)]
    return "\n".join([head, rule, *body])
