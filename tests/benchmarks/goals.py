"""What is wanted of ours, beside what was measured: met or not, from the same figures as the tables."""

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
