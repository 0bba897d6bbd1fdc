"""What the peers have in common: the number that a setting states, and the refusal of those that take one record only.

A peer's lags or block rows are swept on seeds of building (`SWEEP` of its module, `leaderboard.py --parts sweep`), and
the best number stands in its `SETTINGS`. Measured records have another length and other orders each: "to suit" goes by
these, with the rule of `to_suit`.
"""

import re

TO_SUIT = "to suit"


def block_rows(setting, order, n_samples, n_channels):
    """Block rows of a peer's Hankel matrices as the setting states, fewer where the record is too short for them."""
    wanted = to_suit(order) if setting == TO_SUIT else stated(setting)
    possible = n_samples // (2 * n_channels + 2) - 1
    return max(order + 1, min(wanted, possible))


def to_suit(order, *, least=40, most=60):
    """Three block rows a state, 40 to 60."""
    return min(max(3 * order, least), most)


def stated(setting):
    """The number in a setting such as "N4SID, 100 block rows"."""
    return int(re.search(r"(\d+)(?: block rows| lags|-sample windows)$", setting).group(1))


def only_one(records, who):
    if len(records) > 1:
        raise NotImplementedError(f"{who} takes one record, not {len(records)} of one system")
    return records[0]
