"""What a model that can be kept in a file has: `save` and `load`."""

from pathlib import Path
from typing import Any, Literal, Self

from okid.errors import UnreadableFileError

__all__ = ["KeptModel"]


class KeptModel:
    """Saving and loading, for the models that `modal.structure.model_file` knows."""

    __slots__ = ()

    def save(self, path: str | Path, *, existing: Literal["refuse", "replace"] = "refuse") -> Path:
        """Write the model as TOML, JSON or NPZ, by the ending of the path; read it with `load`.

        Args:
            path: Of the file.
            existing: "refuse" (an error when the file is there) or "replace".

        Raises:
            InvalidDataError: Another ending, the file is there already, or it cannot be written.
        """
        from modal.structure.model_file import write_model

        model: Any = self
        return write_model(model, path, existing=existing)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read such a model from a file.

        Args:
            path: Of the file.

        Raises:
            UnreadableFileError: No such file, or one that holds no such model.
        """
        from modal.structure.model_file import read_model

        model = read_model(path)
        if not isinstance(model, cls):
            raise UnreadableFileError(
                f"{path} holds a {type(model).__name__}, not a {cls.__name__}; read it with modal.read_model."
            )
        return model
