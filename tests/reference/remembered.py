"""A function that works once for the same arguments: for tests of what becomes of a result, not of the result."""

import functools
import pickle


def remembered(function):
    """The function with a memory: what it gave for arguments of the same bytes it gives again.

    Results are frozen, so that no test changes what another one gets. `progress` is told nothing, so a test of what is
    told takes the function itself.
    """
    known = {}

    @functools.wraps(function)
    def once(*given, progress=None, **options):
        key = pickle.dumps((given, sorted(options.items())))
        if key not in known:
            known[key] = function(*given, **options)
        return known[key]

    return once
