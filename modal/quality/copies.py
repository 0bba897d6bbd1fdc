"""Two channels that are one signal: recorded twice, wired in parallel, or made from one another."""

from collections.abc import Sequence

import numpy as np

from modal.quality.channel import named, spoken
from modal.quality.findings import Finding
from okid.arrays import FloatArray
from okid.record import Record
from okid.rows import complete_rows

__all__ = ["copy_findings"]

EXACT = 1e-9
"""One minus the modulus of the correlation: residual of 4e-5 of the motion, as left by rounding to five digits."""
MOST_ROWS = 100_000
_SAME_FACTOR = 1e-4


def copy_findings(records: Sequence[Record]) -> list[Finding]:
    """Pairs with an output of which one is a multiple of the other; copies among inputs the excitation check names.

    Args:
        records: of one system.
    """
    values = _some_rows(records)
    if len(values) < 8:
        return []
    n_inputs = records[0].n_inputs
    names = (*records[0].input_names, *records[0].output_names)
    roles = ("input",) * n_inputs + ("output",) * records[0].n_outputs
    values = values - values.mean(axis=0)
    size = np.sqrt(np.mean(values**2, axis=0))
    gram = values.T @ values / len(values)
    moving = size > 0.0
    found: list[Finding] = []
    taken: set[int] = set()
    for j in range(n_inputs, len(names)):
        for i in range(j):
            if not (moving[i] and moving[j]) or j in taken:
                continue
            correlation = gram[i, j] / (size[i] * size[j])
            if abs(correlation) < 1.0 - EXACT:
                continue
            taken.add(j)
            found.append(_finding(roles[i], names[i], names[j], float(np.sign(correlation) * size[j] / size[i])))
    return found


def _finding(role: str, first: str, second: str, factor: float) -> Finding:
    equal = abs(abs(factor) - 1.0) < _SAME_FACTOR
    sign = "the negative of" if factor < 0 and equal else "" if equal else f"{spoken(factor)} times"
    what = f"is {sign} {role} {named(first)}".replace("  ", " ") if sign else f"is the same as {role} {named(first)}"
    return Finding(
        level="bad" if equal else "doubtful",
        what="copied channel",
        where=named((first, second)),
        sentence=f"output {named(second)} {what}, sample by sample: one signal was recorded twice, so it says nothing "
        "new and sets a false shape; look at the wiring and leave one of them out.",
        channels=(first, second),
    )


def _some_rows(records: Sequence[Record]) -> FloatArray:
    """Complete rows from the start of each record, at most 100 000."""
    taken = []
    for record in records:
        rows = slice(0, max(8, MOST_ROWS // len(records)))
        block = np.concatenate([record.inputs[rows], record.outputs[rows]], axis=1)
        taken.append(block[complete_rows(block)])
    return np.concatenate(taken)
