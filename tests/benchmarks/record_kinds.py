"""Records of each kind that the product has never seen: kinds told, modes called, false modes and sentences, intervals.

    python tests/benchmarks/record_kinds.py --kinds transient decay --seeds 1-12

Seeds below 1000 are for building. A mode counts as called where a "system" mode lies within 0.5 % of its frequency (or
half its half-power bandwidth); only excitable modes count as missed; a "system" mode with no true one within 5 % is
false; an untrue sentence counts like a false mode. Intervals: shares of errors of called modes within 1.96 stated
standard deviations, frequency and damping. Error / bound: pooled root mean square (decays).
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import modal
from okid.errors import IdentificationError
from okid.record import Record

sys.path.append(str(Path(__file__).parents[1] / "reference"))
from field_records import KINDS, KindRecords, random_records

FADES = "dies away after each blow"
"""Untrue where no mode is missing."""
UNTRUE = {
    "transient": (
        "never moves",
        "not linear",
        "periodic disturbance",
        "too few frequencies",
        "samples late",
        "does not die away as a mode does",
    ),
    "decay": (
        "not linear",
        "does not die away as a mode does",
        "periodic disturbance",
        "colour of what drives",
        "No input was given",
    ),
    "driven": ("never moves", "periodic disturbance"),
    "ambient": ("periodic disturbance",),
}
"""Words of sentences that are untrue of every record of a kind."""
NEAR = 0.005
FALSE = 0.05
MISSED = 9.0
"""Errors beyond so many bounds, or stated deviations, are counted apart."""


class Score:
    """What the records of one kind came to."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.n = self.right = self.undecided = self.failed = 0
        self.excitable = self.called = self.false = self.untrue = self.beyond = 0
        self.z: list[float] = []
        self.over_bound: list[float] = []
        self.seconds: list[float] = []

    def line(self) -> str:
        z = np.abs(np.array(self.z or [np.nan]))
        over = np.array(self.over_bound or [np.nan])
        return (
            f"{self.kind:10s} records {self.n:3d}  kind right {self.right:3d} undecided {self.undecided:2d}  "
            f"refused {self.failed:2d}  called {self.called}/{self.excitable} "
            f"({100 * self.called / max(1, self.excitable):.0f} %)  false modes {self.false}  untrue {self.untrue}  "
            f"intervals {100 * np.mean(z < 1.96):.1f} % of {z.size} (rms z {np.sqrt(np.mean(z**2)):.2f}, "
            f"beyond 9: {self.beyond})  "
            f"error/bound {np.sqrt(np.mean(over**2)):.2f}  CPU {np.mean(self.seconds or [np.nan]):.2f} s"
        )


def product_records(truth: KindRecords) -> list[Record]:
    return [Record(u, y, truth.dt) for u, y in truth.records]


def score_one(score: Score, truth: KindRecords, *, show: bool, **options) -> None:
    score.n += 1
    score.excitable += int(truth.excitable.sum())
    begun = time.process_time()
    try:
        result = modal.identify(product_records(truth), **options)
    except IdentificationError as error:
        score.failed += 1
        if show:
            print(f"   {truth.words}: refused: {error}")
        return
    score.seconds.append(time.process_time() - begun)
    kind = getattr(result, "record_kind", "none")
    told = any("record kind" in words for words in result.warnings)
    score.right += kind == truth.kind and not told
    score.undecided += told
    system = [mode for mode in result.modes.system if mode.kind == "oscillatory"]
    found = []
    for i, (f, zeta) in enumerate(zip(truth.frequencies, truth.damping_ratios, strict=True)):
        near = [m for m in system if abs(m.frequency - f) <= max(NEAR, zeta) * f]
        mode = min(near, key=lambda m: abs(m.frequency - f), default=None)
        found.append(mode is not None)
        if mode is None:
            continue
        score.called += bool(truth.excitable[i])
        pairs = (
            (mode.frequency - f, mode.frequency_std, None if truth.frequency_std is None else truth.frequency_std[i]),
            (
                mode.damping_ratio - zeta,
                mode.damping_ratio_std,
                None if truth.damping_ratio_std is None else truth.damping_ratio_std[i],
            ),
        )
        for error, std, bound in pairs:
            if np.isfinite(std) and std > 0:
                score.beyond += abs(error) > MISSED * std
                score.z.append(min(abs(error) / std, MISSED))
            if bound is not None:
                score.over_bound.append(min(abs(error) / bound, MISSED))
    false = [
        m for m in result.modes.system if not np.any(np.abs(truth.frequencies - m.frequency) <= FALSE * m.frequency)
    ]
    sentences = [
        *result.warnings,
        *(m.reason for m in result.modes if m.verdict != "noise"),
        *(c.value for c in result.choices),
    ]
    missing = any(e and not one for one, e in zip(found, truth.excitable, strict=True))
    never = (*UNTRUE[truth.kind], *(() if missing else (FADES,)))
    untrue = [words for words in sentences if any(one in words for one in never)]
    score.false += len(false)
    score.untrue += len(untrue)
    if show:
        missed = [
            f"{f:.4g}" for f, one, e in zip(truth.frequencies, found, truth.excitable, strict=True) if e and not one
        ]
        print(
            f"   {truth.words}: {kind}, fit {result.fit.mean:.3f}, {sum(found)} of {int(truth.excitable.sum())}"
            f"; missed {missed}; false {[round(m.frequency, 4) for m in false]}; {score.seconds[-1]:.2f} s; {untrue}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--seeds", default="1-6")
    parser.add_argument("--records", type=int, default=None, help="records a structure")
    parser.add_argument("--cell", type=float, default=0.0, help="noise of the sensors of force, over their peak")
    parser.add_argument("--show", action="store_true", help="a line a record")
    arguments = parser.parse_args()
    first, _, last = arguments.seeds.partition("-")
    scores = []
    for kind in arguments.kinds:
        score = Score(kind)
        for seed in range(int(first), int(last or first) + 1):
            if arguments.show:
                print(f"{kind} {seed}", end="")
            truth = random_records(kind, seed, n_records=arguments.records, cell=arguments.cell)
            score_one(score, truth, show=arguments.show)
        scores.append(score)
        print(score.line(), flush=True)


if __name__ == "__main__":
    main()
