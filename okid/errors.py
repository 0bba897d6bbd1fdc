"""Every error that the three packages raise, as one tree.

```
IdentificationError(Exception)     the root: catch this to catch all of ours
├── InvalidDataError(ValueError)   arrays, names or numbers that cannot be a record, a fit or a model
│   ├── UnreadableFileError        a file that does not exist, is damaged, or holds something else than it says
│   └── InsufficientDataError      well-formed data that are too short or too poor for what was asked
└── NumericalError                 an algorithm met a state from which it cannot give an honest answer
```

A message is one sentence: the rule, the numbers, the remedy.
"""

import contextlib
import re
import threading
import unicodedata
import warnings
from collections.abc import Iterator

_TOO_LONG = re.compile(r"(?<![^\s(\[])'[^']{240,}'|\S{240,}")
_HIDDEN = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Unicode categories that show nothing themselves but change what is around them (and lone surrogates)."""


def visible(text: str) -> str:
    r"""The text on one line, each control or direction-changing character replaced by U+FFFD.

    Example:
        >>> visible("floor\t1"), visible("\x1b[2J") == "\N{REPLACEMENT CHARACTER}[2J"
        ('floor 1', True)
    """
    spaced = re.sub(r"[\t\r\n\v\f]+", " ", text)
    return "".join(
        "\N{REPLACEMENT CHARACTER}" if unicodedata.category(letter) in _HIDDEN else letter for letter in spaced
    )


def encodable(text: str) -> str:
    r"""The text with "?" for what is no letter: half a pair, or a byte of a file name in another code page.

    Example:
        >>> encodable("run\udcff"), encodable("Prüfstand")
        ('run?', 'Prüfstand')
    """
    return text.encode("utf-8", "replace").decode("utf-8")


def _sentence(text: str) -> str:
    """The text as a terminal may have it; the middle of a word or quotation that is too long to be read is left out."""
    shown = _TOO_LONG.sub(lambda found: f"{found[0][:80]}…{found[0][-80:]}", visible(text))
    return shown if not shown or shown.endswith((".", "!", "?", ".)")) else f"{shown}."


class IdentificationError(Exception):
    """Root of the tree; never raised itself.

    A message may quote names that others wrote, and ends in a terminal: it shows control characters, and obeys none.
    """

    def __str__(self) -> str:
        return _sentence(super().__str__())


class InvalidDataError(IdentificationError, ValueError):
    """Arrays, names or numbers that cannot be a record, a fit or a model."""


class UnreadableFileError(InvalidDataError):
    """A file that does not exist, is damaged, or holds something else than it says."""


class InsufficientDataError(InvalidDataError):
    """Well-formed data that are too short or too poor for what was asked."""


class NumericalError(IdentificationError):
    """An algorithm met a state from which it cannot give an honest answer."""


class ExecutorError(IdentificationError):
    """What was to do the work cannot: an executor that broke, a scheduler that is not there."""


class IdentificationWarning(UserWarning):
    """The result stands, but the caller should act on what the text says."""

    def __str__(self) -> str:
        return _sentence(super().__str__())


class _Quiet:
    """How many blocks are quiet now, and the filters as they were before the first."""

    lock = threading.Lock()
    n_open = 0
    before = warnings.catch_warnings()


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """No warning is shown until the block ends: what it says is known, or told in another way.

    `warnings.catch_warnings` alone is not made for threads: of two blocks that overlap, the first to end would leave
    the filters of the second behind for ever. Here the last to end puts the filters back.
    """
    with _Quiet.lock:
        if _Quiet.n_open == 0:
            _Quiet.before = warnings.catch_warnings()
            _Quiet.before.__enter__()
            warnings.simplefilter("ignore")
        _Quiet.n_open += 1
    try:
        yield
    finally:
        with _Quiet.lock:
            _Quiet.n_open -= 1
            if _Quiet.n_open == 0:
                _Quiet.before.__exit__(None, None, None)
