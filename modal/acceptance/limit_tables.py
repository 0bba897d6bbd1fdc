"""The [[limits]] of a test file: each table becomes the condition that its `kind` names."""

import math
from collections.abc import Callable

from modal.acceptance.limits import (
    DampingRange,
    FitAtLeast,
    Limit,
    ModeCount,
    ModeExpected,
    ModeForbidden,
    SettledVerdicts,
    TrustAtLeast,
    UncertaintyAtMost,
)
from modal.acceptance.toml_tables import Table
from okid.errors import InvalidDataError

__all__ = ["limits_of"]

_LONGEST_NAME = 200
_MOST_LIMITS = 1000
_RATIO = "a damping ratio is a share: write 2 % as 0.02"


def limits_of(table: Table) -> tuple[Limit, ...]:
    """The conditions of a test file, in its order.

    Args:
        table: the whole file.

    Raises:
        InvalidDataError: a kind or key that is not known, a value that is missing or none, or more than 1000 of them.

    Example:
        >>> limits_of(Table(values={"limits": [{"kind": "fit", "at_least": 0.9}]}, where="test.toml"))
        (FitAtLeast(name='', at_least=0.9),)
    """
    tables = table.tables("limits", "limit")
    if len(tables) > _MOST_LIMITS:
        raise InvalidDataError(f"{table.where} has {len(tables)} limits, at most {_MOST_LIMITS} are weighed.")
    return tuple(_KINDS[one.word("kind", tuple(_KINDS))](one) for one in tables)


def _name(table: Table, *keys: str) -> str:
    """The name of a limit, once its keys are known to be right."""
    table.refuse_others(("kind", "name", *keys))
    return table.text("name", longest=_LONGEST_NAME)


def _mode(table: Table) -> ModeExpected:
    return ModeExpected(
        name=_name(table, "frequency", "damping"),
        frequency=table.pair("frequency", least=0.0),
        damping=table.pair_or_none("damping", least=-1.0, most=1.0, remedy=_RATIO),
    )


def _no_mode(table: Table) -> ModeForbidden:
    return ModeForbidden(name=_name(table, "frequency"), frequency=table.pair("frequency", least=0.0))


def _n_modes(table: Table) -> ModeCount:
    name = _name(table, "at_least", "at_most")
    _need_one(table, "at_least", "at_most")
    least, most = table.number_or("at_least", 0, least=0), table.number_or("at_most", math.inf, least=0)
    _need_order(table, least, most)
    return ModeCount(name=name, at_least=least, at_most=most)


def _damping(table: Table) -> DampingRange:
    name = _name(table, "at_least", "at_most", "frequency")
    _need_one(table, "at_least", "at_most")
    least, most = (
        table.number(key, least=-1.0, most=1.0, remedy=_RATIO) if table.has(key) else otherwise
        for key, otherwise in (("at_least", -math.inf), ("at_most", math.inf))
    )
    _need_order(table, least, most)
    return DampingRange(name=name, damping=(least, most), frequency=table.pair_or_none("frequency", least=0.0))


def _fit(table: Table) -> FitAtLeast:
    return FitAtLeast(name=_name(table, "at_least"), at_least=table.number("at_least", least=0.0, most=1.0))


def _uncertainty(table: Table) -> UncertaintyAtMost:
    keys = ("frequency_at_most", "damping_at_most")
    name = _name(table, *keys, "frequency")
    _need_one(table, *keys)
    frequency, damping = (table.number(key, least=0.0) if table.has(key) else None for key in keys)
    return UncertaintyAtMost(
        name=name,
        frequency_share=frequency,
        damping_share=damping,
        frequency=table.pair_or_none("frequency", least=0.0),
    )


def _settled(table: Table) -> SettledVerdicts:
    return SettledVerdicts(name=_name(table, "frequency"), frequency=table.pair_or_none("frequency", least=0.0))


def _trust(table: Table) -> TrustAtLeast:
    name = _name(table, "at_least")
    word = table.word("at_least", ("carried", "with care"))
    return TrustAtLeast(name=name, at_least="carried" if word == "carried" else "with care")


def _need_one(table: Table, *keys: str) -> None:
    if not any(table.has(key) for key in keys):
        raise InvalidDataError(f"{table.where} needs {' or '.join(keys)}; add one of them.")


def _need_order(table: Table, least: float, most: float) -> None:
    if least > most:
        raise InvalidDataError(f"at_least {least:g} is above at_most {most:g} in {table.where}; swap the two.")


_KINDS: dict[str, Callable[[Table], Limit]] = {
    "mode": _mode,
    "no_mode": _no_mode,
    "n_modes": _n_modes,
    "damping": _damping,
    "fit": _fit,
    "uncertainty": _uncertainty,
    "settled": _settled,
    "trust": _trust,
}
