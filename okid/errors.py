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

__all__ = [
    "IdentificationError",
    "IdentificationWarning",
    "InsufficientDataError",
    "InvalidDataError",
    "NumericalError",
    "UnreadableFileError",
]


class IdentificationError(Exception):
    """Root of the tree; never raised itself."""


class InvalidDataError(IdentificationError, ValueError):
    """Arrays, names or numbers that cannot be a record, a fit or a model."""


class UnreadableFileError(InvalidDataError):
    """A file that does not exist, is damaged, or holds something else than it says."""


class InsufficientDataError(InvalidDataError):
    """Well-formed data that are too short or too poor for what was asked."""


class NumericalError(IdentificationError):
    """An algorithm met a state from which it cannot give an honest answer."""


class IdentificationWarning(UserWarning):
    """The result stands, but the caller should act on what the text says."""
