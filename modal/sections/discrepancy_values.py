"""The numbers and names of a diagnosis as written: effects without underscores, values to the digits they have."""

import math
from collections.abc import Sequence

from modal.discrepancy.results import (
    Calibrated,
    DetectionLimit,
    Diagnosis,
    Finding,
    Hypothesis,
    LawCurve,
    Parameter,
    changed_masses,
    masses_text,
)
from modal.effects.catalogue import effect_name
from modal.simulation.tolerances import NEAR_FLOOR
from modal.wording.text import NINETY_FIVE, listed, number

NAMED_WITHIN = math.sqrt(NEAR_FLOOR)
"""Times the noise floor (root mean square) within which a model explains the data and an effect may be named."""

effect_text = effect_name


def hypothesis_text(hypothesis: Hypothesis) -> str:
    """What a hypothesis has that the calibrated model has not: effects and other masses, or "no effect"."""
    masses = masses_text(hypothesis.masses)
    if not hypothesis.effects:
        return masses or effects_text(())
    return f"{effects_text(hypothesis.effects)}{f' and {masses}' if masses else ''}"


def effects_text(effects: Sequence[tuple[str, str]]) -> str:
    """A set of effects, each with its place, said once where it is the same; "no effect" for the empty one.

    Example:
        >>> effects_text([("cubic_stiffness", "element_1"), ("input_delay", "force")]), effects_text([])
        ('cubic stiffness at element_1 and input delay at force', 'no effect')
        >>> effects_text([("cubic_stiffness", "element_1"), ("coulomb_friction", "element_1")])
        'cubic stiffness and Coulomb friction at element_1'
    """
    if not effects:
        return "no effect"
    places = {where for _, where in effects}
    if len(places) == 1:
        return f"{listed([effect_text(effect) for effect, _ in effects])} at {places.pop()}"
    return listed([f"{effect_text(effect)} at {where}" for effect, where in effects])


def step_text(name: str) -> str:
    """The name of a step in words.

    Example:
        >>> step_text("cubic_stiffness at element_1"), step_text("as given")
        ('+ cubic stiffness at element_1', 'as given')
    """
    effect, _, where = name.partition(" at ")
    return f"+ {effect_text(effect)} at {where}" if where else name


def times_floor(level: float) -> float:
    """Root mean square over that of the noise, from a mean square in units of the floor; nan where it is not known."""
    return math.sqrt(level) if 0.0 <= level < math.inf else math.nan


def times_text(size: float) -> str:
    """Times the noise floor, to three digits; a dash where it is not known.

    Example:
        >>> times_text(1.0236), times_text(425.37), times_text(61234.0), times_text(float("nan"))
        ('1.02', '425', '61200', '–')
    """
    if not math.isfinite(size):
        return "–"
    if size >= 100.0:
        return f"{float(f'{size:.3g}'):.0f}"
    return f"{size:#.3g}" if size >= 0.01 else f"{size:.1g}"


def value_text(value: float, std: float = math.nan) -> str:
    """Value ± standard deviation, to the second digit of the deviation; a common power of ten where that is shorter.

    Example:
        >>> value_text(0.2481, 0.0011), value_text(403000.0, 4100.0), value_text(0.009998, 4.6e-6)
        ('0.2481 ± 0.0011', '(4.030 ± 0.041)e5', '(9.9980 ± 0.0046)e-3')
        >>> value_text(0.0), value_text(12.3456)
        ('0', '12.35')
    """
    if not math.isfinite(value):
        return "–"
    if not (math.isfinite(std) and std > 0.0):
        return number(value, 4)
    power, digits = _written(value, std)
    if power == 0:
        return f"{value:.{digits}f} ± {std:.{digits}f}"
    return f"({value / 10.0**power:.{digits}f} ± {std / 10.0**power:.{digits}f})e{power}"


def _written(value: float, std: float) -> tuple[int, int]:
    """Power of ten, 0 for a plain number, and decimals to the second digit of the deviation."""
    power = math.floor(math.log10(max(abs(value), std)))
    digits = max(0, 1 - math.floor(math.log10(std)))
    if -4 < power < 5 and digits <= 6:  # more stand after a power of ten
        return 0, digits
    return power, max(0, 1 - math.floor(math.log10(std / 10.0**power)))


def found_value(one: Parameter) -> str:
    """A parameter as found; one without a deviation was held, unless each record has a value of its own.

    Example:
        >>> found_value(Parameter(name="k_in", value=0.0, std=math.nan, unit="N/m"))
        '0, held'
        >>> found_value(Parameter(name="Fc", value=0.2, std=0.01, unit="N"))
        '0.200 ± 0.010'
        >>> found_value(Parameter(name="a", value=0.0, std=0.0, unit="N/m"))  # a fit that went to nothing
        '0'
    """
    held = math.isnan(one.std) and "over the records" not in one.meaning
    return f"{value_text(one.value)}, held" if held else value_text(one.value, one.std)


def beside_text(value: float, fitted: float, std: float) -> str:
    """A value as it was given, written as the fitted one beside it is.

    Example:
        >>> beside_text(0.00093, 0.0012406, 7e-7), beside_text(400.0, 403.21, 0.6), beside_text(0.0, 2e-7, 1e-9)
        ('0.93e-3', '400', '0')
    """
    if not (math.isfinite(std) and std > 0.0 and math.isfinite(fitted)):
        return number(value, 4)
    power, _ = _written(fitted, std)
    scaled = value / 10.0**power
    text = f"{scaled:.6f}".rstrip("0").rstrip(".") if 1e-3 <= abs(scaled) < 1e6 else number(value, 4)
    return f"{text}e{power}" if power and 1e-3 <= abs(scaled) < 1e6 else text


def interval_text(value: float, std: float) -> str:
    """The 95 % interval of a value, a dash where its deviation is not known.

    Example:
        >>> interval_text(0.2481, 0.0011), interval_text(403000.0, 4100.0)
        ('0.2459 to 0.2503', '(3.950 to 4.110)e5')
    """
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        return "–"
    power, digits = _written(value, std)
    text = " to ".join(f"{(value + side * std) / 10.0**power:.{digits}f}" for side in (-NINETY_FIVE, NINETY_FIVE))
    return f"({text})e{power}" if power else text


def size_text(value: float) -> str:
    """A size in the unit of its channel, to three digits; "unbounded" where the model ran away.

    Example:
        >>> size_text(0.0042071), size_text(1.2e-5), size_text(float("inf"))
        ('0.00421', '1.20e-5', 'unbounded')
    """
    return number(value) if math.isfinite(value) else "unbounded"


def closed_share(closed: float) -> float:
    """Share of the gap above the noise that is gone, as a root mean square, from that of the mean square.

    Example:
        >>> closed_share(0.75), closed_share(-3.0)
        (0.5, 0.0)
    """
    return 1.0 - math.sqrt(1.0 - min(max(closed, 0.0), 1.0)) if math.isfinite(closed) else math.nan


def levels_in_words(hypothesis: Hypothesis) -> str:
    """What a hypothesis leaves on held-out data, in words."""
    size = times_floor(hypothesis.held_out_level)
    if not math.isfinite(size):
        return "does not run through the held-out records"
    return f"leaves {times_text(size)} times the noise floor on held-out data"


def found_hypothesis(diagnosis: Diagnosis) -> Hypothesis | None:
    """The hypothesis that the diagnosis settled on, among those that were fitted; None where it settled on none.

    A hypothesis lists all effects of its model, those that the given model had already among them; the shortest one is
    the given model itself.
    """
    if not diagnosis.findings and diagnosis.status != "none":
        return None
    known = min((one.effects for one in diagnosis.hypotheses), key=len, default=())
    found = sorted([*known, *((finding.effect, finding.where) for finding in diagnosis.findings)])
    masses = sorted(changed_masses(diagnosis))
    alike = [one for one in diagnosis.hypotheses if sorted(one.effects) == found]
    return next((one for one in alike if sorted(one.masses) == masses), None)


def found_word(diagnosis: Diagnosis) -> str:
    """What to call the hypothesis that the diagnosis settled on."""
    return {"named": "found", "none": "enough", "unresolved": "best guess"}[diagnosis.status]


def law_against(law: LawCurve) -> str:
    """What a law is drawn against, with its unit: "displacement [m]"."""
    return f"{law.against} [{law.motion_unit}]" if law.motion_unit else law.against


def law_gives(law: LawCurve) -> str:
    """What a law gives, with its unit: "force [N]"; of an input or a sensor the changed signal."""
    if law.against == "time" and law.effect.startswith("sensor"):
        what = "added to the reading"
    else:
        what = {"input": "input after the effect", "output": "reading"}.get(law.against, "force")
    return f"{what} [{law.force_unit}]" if law.force_unit else what


def signed_change(item: Calibrated) -> float:
    """Relative change of a calibrated parameter, nan where the nominal value is 0."""
    return item.value / item.nominal - 1.0 if item.nominal else math.nan


def value_with_unit(text: str, item: Parameter | Calibrated | DetectionLimit) -> str:
    """A value and its unit."""
    return f"{text} {item.unit}" if item.unit else text


def parameters_text(finding: Finding) -> str:
    """All parameters of a finding: "k3 = (4.03 ± 0.04)e5 N/m^3"."""
    return ", ".join(f"{one.name} = {value_with_unit(found_value(one), one)}" for one in finding.parameters)
