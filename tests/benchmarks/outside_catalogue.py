"""What no entry of the catalogue describes: how often the diagnosis says so, and how good its curves are.

    python tests/benchmarks/outside_catalogue.py --kinds all --seeds 1-3 --work FILE
    python tests/benchmarks/outside_catalogue.py --kinds smooth --seeds 1-3 --without smooth_stiffness --work FILE

Cases come from `tests/reference/outside_laws.py` (an integrator of its own); model and records go in through public
names only. One line of JSON a case in FILE; lines that are there are not made again. "Firm": named, no finding with
`ambiguous_with`. "Firm and wrong": a firm finding that is not the truth's or not at its place, a surplus one, one where
the truth needs two, or "none" where the truth is no wrong mass that was found, no step of a converter and no noise of
another colour. "Named right" of a form-free law: of the right motion at the right place, and its force, with the
calibrated stiffness or damping beside it, lies in its 95 % band over at least 90 % of the motion visited, the band
narrower than a fifth of the largest force. "Curve right": that, and within 3 % of the largest force over 90 % of the
motion. "Class holds": where the truth has names, one of them is a finding or is named as even with one. A case that
raises has failed: it is neither right nor honest. CPU s: the median. The bound is the
largest rate of firm and wrong ones that the count allows at 95 % (Clopper and Pearson), failed ones not counted.
"""

import argparse
import json
import os
import sys
import time
import warnings
from collections import Counter
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"
ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "reference"), str(ROOT / "tests" / "benchmarks")]

import numpy as np  # noqa: E402 - after the threads are set
import scipy  # noqa: E402
from outside_laws import DAMPING, KINDS, SHARP, STIFFNESS, outside_case  # noqa: E402


def model_of(case):
    """The wrong linear model."""
    import modal

    if case.rotary:
        return modal.StructuralModel(
            [[case.masses[0]]], [[case.dampings[0]]], [[0.0]], force_map=[[1.0]], sensor_map=[[1.0]],
            sensor_kind="velocity", length_unit="rad", force_unit="N m",
        )  # fmt: skip
    n, angle = len(case.masses), case.kind == "pendulum"
    return modal.StructuralModel.chain(
        case.masses, case.stiffnesses, case.dampings, force_dofs=[0], sensor_dofs=range(n), sensor_kind="displacement",
        length_unit="rad" if angle else "m", force_unit="N m" if angle else "N",
    )  # fmt: skip


def diagnosed(kind, seed, without=()):
    """One line; `without` are the keys left out of the catalogue."""
    import okid
    from modal.discrepancy import diagnose
    from modal.effects.catalogue import CATALOGUE

    case = outside_case(kind, seed)
    fit, held_out = (
        [okid.Record(one.inputs, one.outputs, one.dt, name=one.name) for one in records]
        for records in (case.fit, case.held_out)
    )
    catalogue = {key: effect for key, effect in CATALOGUE.items() if key not in without}
    line = {"kind": kind, "seed": seed, "without": sorted(without)}
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = diagnose(model_of(case), fit, held_out, catalogue=catalogue)
    except Exception as error:  # noqa: BLE001 - a case that raises is a case that failed
        return {
            **line, "status": f"{type(error).__name__}: {error}"[:120], "failed": True,
            "seconds": time.process_time() - start,
        }  # fmt: skip
    firm = found.status == "named" and not any(one.ambiguous_with for one in found.findings)
    right, curve = judged(case, found)
    names = {key for one in found.findings for key in (one.effect, *one.ambiguous_with)}
    return {
        **line,
        "status": found.status,
        "found": [[one.effect, one.where] for one in found.findings],
        "even": [list(one.ambiguous_with) for one in found.findings],
        "firm": firm,
        "right": right,
        "wrong": bool((firm or found.status == "none") and not right),
        "class_holds": bool(names & set(case.effects)) if case.effects else None,
        "curve": curve,
        "level": float(found.steps[-1].held_out_level),
        "left": [[one.kind, one.where, one.p_value, one.share, one.size] for one in found.lack_of_fit[:2]],
        "seconds": time.process_time() - start,
    }


def judged(case, found):
    """Whether the answer is the truth, and whether its curve is the hidden law."""
    if found.status == "none":
        return nothing_right(case, found), False
    at_place = all(case.place in ("", one.where) for one in found.findings)
    keys = {one.effect for one in found.findings}
    if keys and keys <= set(case.effects) and at_place:
        return keys == set(case.effects) if case.needs_all else len(found.findings) == 1, False
    smooth = [law for law in found.laws if law.effect.startswith("smooth_")]
    if len(found.findings) != 1 or not smooth or case.law is None:
        return False, False
    return curve_right(case, smooth[0], found)


def nothing_right(case, found):
    """Whether no effect is the truth: wrong masses that were found, or steps of a converter and coloured noise."""
    masses = {one.name: one.value for one in found.calibrated if one.name.startswith("mass of")}
    off = [abs(masses.get(f"mass of dof_{i}", np.nan) - mass) / mass for i, mass in enumerate(case.true_masses)]
    wrong_mass = case.kind in ("wrong_mass", "wrong_chain_mass")
    return case.kind in ("quantised", "coloured_noise") or bool(wrong_mass and np.max(off) < 0.02)


def curve_right(case, law, found):
    """Whether a form-free law is in its band, and near the hidden one: the linear parameter beside it counted in."""
    if law.where != case.place or law.against != case.motion:
        return False, False
    word = "stiffness" if case.motion == "displacement" else "damping"
    linear = {one.name: one.value for one in found.calibrated}.get(f"{word} of element_0", np.nan)
    visited = np.concatenate([getattr(one, case.motion) for one in (*case.fit, *case.held_out)])
    visited = visited[(visited >= law.motion.min()) & (visited <= law.motion.max())]
    force = np.interp(visited, law.motion, law.force) + (linear - getattr(case, word)) * visited
    band = 1.96 * np.interp(visited, law.motion, law.deviation)
    truth = case.law(visited)
    off, largest = np.abs(force - truth), np.abs(truth).max()
    named = bool(np.mean(off <= band) >= 0.9 and np.median(band) <= 0.2 * largest)
    return named, named and bool(np.mean(off <= 0.03 * largest) >= 0.9)


def report(lines):
    """A table by kind, and the sums."""
    rows = [
        "| kind | cases | right | firm and wrong | unresolved | failed | class holds | curve right | CPU s | most |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for kind in [*KINDS, "all"]:
        own = [line for line in lines if kind in (line["kind"], "all")]
        if not own:
            continue
        count = Counter()
        for line in own:
            count.update(key for key in ("right", "wrong", "curve", "failed") if line.get(key))
            count["unresolved"] += not line.get("failed") and line["status"] not in ("named", "none")
        held = [line["class_holds"] for line in own if line.get("class_holds") is not None]
        holds = f"{sum(held)} of {len(held)}" if held else "-"
        seconds = [line["seconds"] for line in own]
        rows.append(
            f"| {kind} | {len(own)} | {count['right']} | {count['wrong']} | {count['unresolved']} | {count['failed']} "
            f"| {holds} | {count['curve']} | {np.median(seconds):.1f} | {max(seconds):.1f} |"
        )
    ended = [line for line in lines if not line.get("failed")]
    n, wrong = len(ended), sum(line["wrong"] for line in ended)
    bound = 1.0 if wrong == n else scipy.stats.beta.ppf(0.95, wrong + 1, n - wrong)
    smooth = [line for line in lines if line["kind"] in (*STIFFNESS, *DAMPING)]
    rows.append(f"\nfirm and wrong: {wrong} of {n}, at most {100 * bound:.1f} % (95 %)")
    curves = sum(line.get("curve", False) for line in smooth)
    rows.append(f"curves right where a smooth law of one place is missing: {curves} of {len(smooth)}")
    return "\n".join(rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default="all", help=f"all, smooth, or names of {', '.join(KINDS)}")
    parser.add_argument("--seeds", default="1-3", help="first-last; below 1000 is for building")
    parser.add_argument("--work", type=Path, default=Path("outside.jsonl"), help="file for the lines")
    parser.add_argument("--without", default="", help="keys to leave out of the catalogue, with commas")
    options = parser.parse_args()
    groups = {"all": KINDS, "smooth": (*STIFFNESS, *DAMPING), "sharp": tuple(SHARP)}
    kinds = groups.get(options.kinds) or tuple(options.kinds.split(","))
    first, _, last = options.seeds.partition("-")
    wanted = [(kind, seed) for seed in range(int(first), int(last or first) + 1) for kind in kinds]
    lines = [json.loads(text) for text in options.work.read_text().splitlines()] if options.work.exists() else []
    without = sorted(filter(None, options.without.split(",")))
    done = {(line["kind"], line["seed"], *line["without"]) for line in lines}
    for kind, seed in wanted:
        if (kind, seed, *without) in done:
            continue
        line = diagnosed(kind, seed, without)
        lines.append(line)
        with options.work.open("a") as file:
            file.write(json.dumps(line) + "\n")
        print(json.dumps(line), file=sys.stderr, flush=True)
    own = [line for line in lines if (line["kind"], line["seed"]) in set(wanted) and line["without"] == without]
    print(report(own))


if __name__ == "__main__":
    main()
