"""Everyday mistakes diagnosed: how often a firm name is wrong, and how often the mistake itself is named.

    python tests/benchmarks/everyday_mistakes.py --kinds wrong_mass,record_offset --seeds 1-12

Records come from `tests/reference/everyday_mistakes.py`, which imports nothing of the product. "Firm and wrong": status
"named" and a finding that is not the mistake. A wrong mass is right where nothing is named and `calibrated` holds the
true mass within three deviations. Seeds below 1000 are for building.
"""

import argparse
import os
import sys
import time
import warnings
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"
ROOT = Path(__file__).resolve().parents[2]
for folder in (ROOT, ROOT / "tests" / "reference"):
    sys.path.insert(0, str(folder))

from everyday_mistakes import MISTAKES, mistake  # noqa: E402 - after the path is set


def diagnosed(case):
    """The product's answer, and its CPU seconds."""
    import modal
    import okid

    model = modal.StructuralModel.chain(
        case.masses, case.stiffnesses, case.dampings, force_dofs=[case.force_dof], sensor_dofs=list(case.sensor_dofs),
        sensor_kind=case.sensor_kind,
    )  # fmt: skip
    records = [okid.Record(u, y, case.dt) for u, y in case.records]
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = modal.discrepancy.diagnose(model, records[:-1], records[-1])
    return found, time.process_time() - start


def verdict(case, found):
    """ "right", "sensible" (unresolved), "FIRM AND WRONG" or "missed"."""
    names = [(one.effect, one.where) for one in found.findings]
    if case.effect:
        right = names == [(case.effect, case.where)]
    else:
        true = {f"mass of {case.where}": dict(zip(_dofs(case), case.masses, strict=True))[case.where] * (1 + case.size)}
        masses = {one.name: one for one in found.calibrated if one.name.startswith("mass")}
        right = not names and all(
            name in masses and abs(masses[name].value - value) < 0.02 * value for name, value in true.items()
        )
    if right:
        return "right" if found.status != "unresolved" else "right, unresolved"
    firm = found.status == "named" and not any(one.ambiguous_with for one in found.findings)
    return "FIRM AND WRONG" if firm else "missed" if found.status == "none" else "unresolved"


def _dofs(case):
    return [f"dof_{i}" for i in range(len(case.masses))]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default=",".join(MISTAKES))
    parser.add_argument("--seeds", default="1-6")
    options = parser.parse_args()
    first, _, last = options.seeds.partition("-")
    for kind in options.kinds.split(","):
        counts = {}
        for seed in range(int(first), int(last or first) + 1):
            case = mistake(kind, seed)
            try:
                found, seconds = diagnosed(case)
            except Exception as error:  # noqa: BLE001 - a case that raises is a case that is wrong
                word, names, level, seconds = "FAILED", f"{type(error).__name__}: {error}", 0.0, 0.0
            else:
                word, level = verdict(case, found), found.steps[-1].held_out_level
                names = ", ".join(f"{one.effect} at {one.where}" for one in found.findings) or "-"
                names += "".join(
                    f"; {one.name} {one.nominal:.4g} -> {one.value:.4g}"
                    for one in found.calibrated
                    if one.name.startswith("mass") and one.value != one.nominal
                )
            counts[word] = counts.get(word, 0) + 1
            print(
                f"{kind} {seed} size {case.size:.3g}: {word}: {names} ({level:.2f} floors, {seconds:.1f} s)", flush=True
            )
        print(f"== {kind}: {counts}")


if __name__ == "__main__":
    main()
