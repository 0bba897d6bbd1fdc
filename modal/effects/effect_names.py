"""Effects as a person calls them: catalogue keys without underscores, names of people with a capital."""

from collections.abc import Sequence

__all__ = ["effect_name", "effects_at", "one_of"]

_NAMES_KEPT = {"coulomb": "Coulomb", "bouc": "Bouc", "wen": "Wen"}
"""Words of catalogue keys that are people's names."""


def effect_name(key: str) -> str:
    """A catalogue key in words; what is in words already stays.

    Example:
        >>> effect_name("bouc_wen_hysteresis"), effect_name("input_delay"), effect_name("viscous damping")
        ('Bouc-Wen hysteresis', 'input delay', 'viscous damping')
    """
    words = [_NAMES_KEPT.get(word, word) for word in key.split("_") if word]
    return " ".join(words).replace("Bouc Wen", "Bouc-Wen")


def effects_at(effects: Sequence[tuple[str, str]]) -> str:
    """Effects, each with its place.

    Example:
        >>> effects_at([("coulomb_friction", "element_1"), ("input_delay", "force")])
        'Coulomb friction at element_1 and input delay at force'
    """
    return " and ".join(f"{effect_name(key)} at {where}" for key, where in effects)


def one_of(keys: Sequence[str]) -> str:
    """Names of which one is meant.

    Example:
        >>> one_of(["quadratic_drag", "viscous damping"]), one_of(["a_b", "c", "d"])
        ('quadratic drag or viscous damping', 'a b, c or d')
    """
    names = [effect_name(key) for key in keys]
    return " or ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} or {names[-1]}"
