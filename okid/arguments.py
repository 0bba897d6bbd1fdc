"""A stage that is given the result of the wrong stage says which one it takes."""

from okid.errors import InvalidDataError

__all__ = ["require"]


def require(value: object, kind: type, *, where: str, made_by: str) -> None:
    """Refuse anything but an instance of `kind`.

    Args:
        value: what the caller gave.
        kind: the type that is taken.
        where: the function that takes it.
        made_by: how one comes by such a thing.

    Raises:
        InvalidDataError: another type; the message names both and the remedy.

    Example:
        >>> require(3, str, where="f", made_by="str(...)")
        Traceback (most recent call last):
        okid.errors.InvalidDataError: f takes a str, but was given int; make one by str(...).
    """
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise InvalidDataError(
            f"{where} takes {article} {kind.__name__}, but was given {type(value).__name__}; make one by {made_by}."
        )
