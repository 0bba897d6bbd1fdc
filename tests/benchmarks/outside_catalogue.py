"""What no entry of the catalogue describes: how often the diagnosis says so, and how good its curves are.

    python tests/benchmarks/outside_catalogue.py --kinds all --seeds 1-3 --work FILE

Cases come from `tests/reference/outside_laws.py` (an integrator of its own); model and records go in through public
names only. One line of JSON a case in FILE; lines that are there are not made again. "Firm": named, no finding with
`ambiguous_with`. "Firm and wrong": a firm finding that is not the truth's, or a surplus one, or "none" where the truth
is no wrong mass that was found, no step of a converter and no noise of another colour. "Curve right": a form-free
law of the right motion at the right place whose force, with the calibrated stiffness or damping beside it, lies in its
95 % band over at least 90 % of the motion visited, or within 3 % of the largest force everywhere. The bound is the
largest rate of firm and wrong ones that the count allows at 95 % (Clopper and Pearson).
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


def diagnosed(kind, seed):
    """One line."""
    import okid
    from modal.discrepancy import diagnose

    case = outside_case(kind, seed)
    fit, held_out = (
        [okid.Record(one.inputs, one.outputs, one.dt, name=one.name) for one in records]
        for records in (case.fit, case.held_out)
    )
    line = {"kind": kind, "seed": seed}
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = diagnose(model_of(case), fit, held_out)
    except Exception as error:  # noqa: BLE001 - a case that raises is a case that failed
        return {**line, "status": f"{type(error).__name__}: {error}"[:120], "seconds": time.process_time() - start}
    names = [[one.effect, one.where] for one in found.findings]
    firm = found.status == "named" and not any(one.ambiguous_with for one in found.findings)
    smooth = [law for law in found.laws if law.effect.startswith("smooth_")]
    curve = bool(smooth) and len(names) == 1 and case.law is not None and curve_right(case, smooth[0], found)
    right = bool(names) and (curve or all(key in case.effects for key, _ in names))
    right = right or (found.status == "none" and nothing_right(case, found))
    held = case.effects == () or any(
        key in case.effects for one in found.findings for key in (one.effect, *one.ambiguous_with)
    )
    return {
        **line,
        "status": found.status,
        "found": names,
        "even": [list(one.ambiguous_with) for one in found.findings],
        "firm": firm,
        "right": bool(right),
        "wrong": bool((firm or found.status == "none") and not right),
        "class_holds": bool(held),
        "curve": curve,
        "level": float(found.steps[-1].held_out_level),
        "left": [[one.kind, one.where, one.p_value, one.share, one.size] for one in found.lack_of_fit[:2]],
        "seconds": time.process_time() - start,
    }


def nothing_right(case, found):
    """Whether no effect is the truth: wrong masses that were found, or steps of a converter and coloured noise."""
    masses = {one.name: one.value for one in found.calibrated if one.name.startswith("mass of")}
    off = [abs(masses.get(f"mass of dof_{i}", np.nan) - mass) / mass for i, mass in enumerate(case.true_masses)]
    return case.kind in ("quantised", "coloured_noise") or (case.kind == "wrong_mass" and max(off) < 0.02)


def curve_right(case, law, found):
    """Whether a form-free law is the hidden one: the linear parameter that was calibrated beside it counted in."""
    if law.where != "element_0" or law.against != case.motion:
        return False
    word = "stiffness" if case.motion == "displacement" else "damping"
    linear = {one.name: one.value for one in found.calibrated}.get(f"{word} of element_0", np.nan)
    visited = np.concatenate([getattr(one, case.motion) for one in (*case.fit, *case.held_out)])
    visited = visited[(visited >= law.motion.min()) & (visited <= law.motion.max())]
    force = np.interp(visited, law.motion, law.force) + (linear - getattr(case, word)) * visited
    band = 1.96 * np.interp(visited, law.motion, law.deviation)
    truth = case.law(visited)
    off, largest = np.abs(force - truth), np.abs(truth).max()
    return bool(np.mean(off <= band) >= 0.9 and np.median(band) <= 0.2 * largest) or bool(off.max() <= 0.03 * largest)


def report(lines):
    """A table by kind, and the sums."""
    rows = [
        "| kind | cases | right | firm and wrong | unresolved | curve right | CPU s, median | most |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for kind in [*KINDS, "all"]:
        own = [line for line in lines if kind in (line["kind"], "all")]
        if not own:
            continue
        count = Counter()
        for line in own:
            count["right"] += line.get("right", False)
            count["wrong"] += line.get("wrong", False)
            count["curve"] += line.get("curve", False)
            count["unresolved"] += line["status"] not in ("named", "none")
        seconds = [line["seconds"] for line in own]
        rows.append(
            f"| {kind} | {len(own)} | {count['right']} | {count['wrong']} | {count['unresolved']} | {count['curve']} | "
            f"{np.median(seconds):.1f} | {max(seconds):.1f} |"
        )
    n, wrong = len(lines), sum(line.get("wrong", False) for line in lines)
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
    options = parser.parse_args()
    groups = {"all": KINDS, "smooth": (*STIFFNESS, *DAMPING), "sharp": tuple(SHARP)}
    kinds = groups.get(options.kinds) or tuple(options.kinds.split(","))
    first, _, last = options.seeds.partition("-")
    wanted = [(kind, seed) for seed in range(int(first), int(last or first) + 1) for kind in kinds]
    lines = [json.loads(text) for text in options.work.read_text().splitlines()] if options.work.exists() else []
    done = {(line["kind"], line["seed"]) for line in lines}
    for kind, seed in wanted:
        if (kind, seed) in done:
            continue
        line = diagnosed(kind, seed)
        lines.append(line)
        with options.work.open("a") as file:
            file.write(json.dumps(line) + "\n")
        print(json.dumps(line), file=sys.stderr, flush=True)
    print(report([line for line in lines if (line["kind"], line["seed"]) in set(wanted)]))


if __name__ == "__main__":
    main()
