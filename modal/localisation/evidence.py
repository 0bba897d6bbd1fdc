"""Where measurement and simulation disagree, in words: the evidence that a person reads before anything is fitted.

Each sentence follows from one rule on the numbers of a `Gap`, of `LevelModes` and of `Lines`; where the numbers do not
carry a sentence it is not said. Nothing here names an effect: the words are those of families of laws.
"""

from dataclasses import dataclass

import numpy as np

from modal.localisation.character import coherent_share
from modal.localisation.gap import BEYOND_CHANCE, Gap
from modal.localisation.levels import LevelModes
from modal.localisation.lines import Lines, line_statements
from modal.localisation.words import agreement, disagreement, mode_statements
from modal.simulation.tolerances import AT_FLOOR
from modal.wording.numbers import Statement
from okid.arrays import BoolArray, FloatArray
from okid.display import Displayed

__all__ = ["Location", "locate"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Location(Displayed):
    """What is known of the gap before any candidate is fitted.

    Attributes:
        statements: the most general first.
        agrees: whether the gap is nowhere above the noise; then one statement says so.
        output: index of the output that holds most of the gap relative to its size.
        output_shares: (n_outputs,) share of each output, zeros where there is no gap.
        coherent: (n_outputs,) share of the gap that is coherent with the simulated output.
        modes: frequency and damping of each mode at each level, None where they were not asked for.
    """

    statements: tuple[Statement, ...]
    agrees: bool
    output: int
    output_shares: FloatArray
    coherent: FloatArray
    modes: LevelModes | None = None

    @property
    def sentences(self) -> tuple[str, ...]:
        """The texts of the statements."""
        return tuple(statement.text for statement in self.statements)


def locate(gap: Gap, *, modes: LevelModes | None = None, lines: Lines | None = None) -> Location:
    """Say where measurement and simulation disagree: output, band, level, time, modes, lines.

    Args:
        gap: from `measure_gap`.
        modes: from `level_modes` on the measured records, None to leave them out.
        lines: from `measure_lines` on the measured records, None to leave them out.

    Example:
        >>> from modal.localisation.gap import measure_gap
        >>> from okid.record import Record
        >>> rng = np.random.default_rng(1)
        >>> force, noise = rng.standard_normal(2000), 0.01 * rng.standard_normal(2000)
        >>> hum = 0.1 * np.sin(2 * np.pi * 12.0 * np.arange(2000) * 0.01)
        >>> simulated = Record(force, force, 0.01)
        >>> print(*locate(measure_gap(Record(force, force + noise, 0.01), simulated, 1e-4)).sentences)
        Measurement and simulation agree within the noise: the gap is 0.999 times the noise floor.
        >>> found = locate(measure_gap(Record(force, force + hum + noise, 0.01), simulated, 1e-4))
        >>> print(found.sentences[1])
        99.9 % of the gap is between 11.97 and 12.03 Hz, as is under 1 % of the simulated motion.
    """
    limit = AT_FLOOR + BEYOND_CHANCE * np.sqrt(2.0 / np.maximum(1, gap.windows.n_samples.sum(axis=1)))
    above: BoolArray = gap.in_floors > limit
    coherent = coherent_share(gap)
    shares = _output_shares(gap, above)
    output = int(np.argmax(shares))
    agrees = not bool(above.any())
    if agrees:
        statements = [agreement(gap)]
    else:
        statements = list(disagreement(gap, above=above, output=output, shares=shares, coherent=coherent))
        statements += [] if lines is None or not lines.measured else line_statements(lines)
        statements += [] if modes is None or modes.levels.size < 2 else mode_statements(modes)
    return Location(
        statements=tuple(statements), agrees=agrees, output=output, output_shares=shares, coherent=coherent, modes=modes
    )


def _output_shares(gap: Gap, above: BoolArray) -> FloatArray:
    """(n_outputs,) each output's part of the sum of mean squares above the noise, relative to its variance."""
    excess = np.where(above, np.maximum(np.nan_to_num(gap.excess), 0.0), 0.0).sum(axis=0)
    total = float(excess.sum())
    shares: FloatArray = excess / total if total > 0.0 else np.zeros_like(excess)
    return shares
