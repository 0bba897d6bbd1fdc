"""Units of the parameters of an effect at its place."""

from modal.effects.effect import Effect, ForceEffect, ParameterKind
from modal.simulation.plant import Plant

__all__ = ["composed_unit", "parameter_units"]


def composed_unit(dimension: tuple[int, int, int], *, force_unit: str, length_unit: str) -> str:
    """The unit force^a length^b s^c in plain text.

    Args:
        dimension: Powers (a, b, c).
        force_unit: Unit of the force, or of the channel.
        length_unit: Unit of the displacement.

    Example:
        >>> composed_unit((1, -3, 0), force_unit="N", length_unit="m")
        'N/m^3'
        >>> composed_unit((1, -2, 2), force_unit="N m", length_unit="rad")
        'N m s^2/rad^2'
        >>> composed_unit((1, -1, 0), force_unit="m/s^2", length_unit="m"), composed_unit((0, 0, -1),
        ...     force_unit="N", length_unit="m")
        ('(m/s^2)/m', 'Hz')
    """
    if dimension == (0, 0, -1):
        return "Hz"
    factors = [
        (unit, power) for unit, power in zip((force_unit, length_unit, "s"), dimension, strict=True) if power and unit
    ]
    above = [_power(unit, power, alone=len(factors) == 1) for unit, power in factors if power > 0]
    below = [_power(unit, -power, alone=False) for unit, power in factors if power < 0]
    if not below:
        return " ".join(above)
    under = below[0] if len(below) == 1 and " " not in below[0] else f"({' '.join(below)})"
    return f"{' '.join(above) or '1'}/{under}"


def parameter_units(plant: Plant, effect: Effect, where: str) -> tuple[str, ...]:
    """The unit of each parameter of an effect at a place of a plant; "" for a pure number or an unknown unit.

    Raises:
        KeyError: There is no such port.
    """
    if isinstance(effect, ForceEffect):
        port = plant.port(where)
        force, length = port.force_unit, port.length_unit
    else:
        names = (*plant.input_names, *plant.output_names)
        units = dict(zip(names, (*plant.input_units, *plant.output_units), strict=True))
        force, length = units[where], ""
    return tuple(_unit(kind, force, length) for kind in effect.parameters)


def _unit(kind: ParameterKind, force: str, length: str) -> str:
    return composed_unit(kind.dimension, force_unit=force, length_unit=length)


def _power(unit: str, power: int, *, alone: bool) -> str:
    """`unit` to a power, in brackets where it would be misread."""
    compound = "/" in unit or (" " in unit and power > 1)
    named = f"({unit})" if compound and not (alone and power == 1) else unit
    return named if power == 1 else f"{named}^{power}"
