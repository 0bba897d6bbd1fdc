"""What the last digits of the data change: every record identified twice, once with its digits changed at 1e-12.

    python tests/benchmarks/rounding_board.py --families white,shaker --seeds 1-4

Nothing that an engineer could measure lies between the two, so the modes should not differ by more than a part of their
deviations, and no verdict should. Families: the noises of `noise_families`, the kinds of `field_records`, and the
tables of `response_tables` (white forces, one shaker that the structure loads, two).
"""

import argparse
import os
import sys
import time
import warnings
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "reference"), str(ROOT / "tests" / "benchmarks")]

import field_records  # noqa: E402  threads and path are set above
import noise_families  # noqa: E402
import numpy as np  # noqa: E402
from response_tables import table_of  # noqa: E402

import modal  # noqa: E402
from okid.errors import IdentificationError  # noqa: E402
from okid.frequency_response import FrequencyResponse  # noqa: E402
from okid.record import Record  # noqa: E402

DIGITS = 1e-12
TABLES = ("table", "shaker", "shakers")
SHIFTED = 0.5
"""Count modes that move by more of their own deviation."""


def rounded(values, rng):
    """The same but for its last digits; zeros stay."""
    return values if values is None or rng is None else values * (1 + DIGITS * rng.standard_normal(values.shape))


def drawn(family, seed, rng):
    """What `modal.identify` takes."""
    if family in TABLES:
        test = table_of(seed, n_samples=1024, kind="white" if family == "table" else family)
        known = {"coherence": test.coherence, "n_averages": test.n_averages, "window": "hann"}
        return FrequencyResponse(rounded(test.response, rng), test.frequencies, **known)
    if family in noise_families.KINDS:
        case = noise_families.noise_record(family, system=seed, record=seed)
        return Record(rounded(case.inputs, rng), rounded(case.outputs, rng), case.system.dt)
    truth = field_records.random_records(family, seed)
    return [Record(rounded(u, rng), rounded(y, rng), truth.dt) for u, y in truth.records]


def identified(family, seed, rng):
    """The result, None where it is refused."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return modal.identify(drawn(family, seed, rng))
        except IdentificationError:
            return None


def compared(first, second):
    """Orders equal or not, modes that are certain in one of the two only, the largest shift in deviations."""
    if first is None or second is None:
        return first is second, 0 if first is second else 1, 0.0, 0
    lost, shifts, n = 0, [], 0
    for these, those in ((first, second), (second, first)):
        for mode in these.modes.system:
            n += 1
            twin = min(those.modes, key=lambda other: abs(other.pole - mode.pole), default=None)
            if twin is None or twin.verdict != "system":
                lost += 1
                continue
            parts = [
                abs(getattr(mode, name) - getattr(twin, name)) / std
                for name in ("frequency", "damping_ratio")
                if np.isfinite(std := getattr(mode, f"{name}_std")) and std > 0
            ]
            shifts.append(max(parts, default=0.0))
    return first.fitted_model.order == second.fitted_model.order, lost, np.array(shifts), n


def main():
    """Print a line a family."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    families = [*noise_families.KINDS, *field_records.KINDS, *TABLES]
    parser.add_argument("--families", default=",".join(families))
    parser.add_argument("--seeds", default="1-4")
    chosen = parser.parse_args()
    first, last = (int(end) for end in chosen.seeds.split("-"))
    seeds = range(first, last + 1)
    for family in chosen.families.split(","):
        orders, lost, n, shifts, cpu, which = 0, 0, 0, [0.0], time.process_time(), []
        for seed in seeds:
            same, gone, shift, modes = compared(
                identified(family, seed, None), identified(family, seed, np.random.default_rng(seed))
            )
            orders, lost, n = orders + (not same), lost + gone, n + modes
            shifts.extend(np.atleast_1d(shift))
            if not same or gone or np.max(shift, initial=0.0) > SHIFTED:
                which.append(seed)
        seconds = (time.process_time() - cpu) / 2 / len(seeds)
        print(
            f"{family:10s} records {len(seeds):3d}  other order {orders:2d}  certain in one only {lost:2d} of {n:3d}  "
            f"moved by over half a deviation {int((np.array(shifts) > SHIFTED).sum()):2d}, most "
            f"{max(shifts):.2g} deviations  CPU {seconds:.1f} s  {which or ''}",
            flush=True,
        )


if __name__ == "__main__":
    main()
