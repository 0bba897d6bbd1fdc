"""A progress bar that says how long the work will still take, as far as that can be known."""

import contextlib
import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

__all__ = ["Progress", "progress_bar", "time_left_text"]

Progress = Callable[[str, float], None]
"""Called with what is being done and the share of all work that is behind."""

LEAST_SHARE = 0.05
LEAST_SECONDS = 1.5
"""Before this share and this time nothing is said: the start says little about the rest."""


@contextlib.contextmanager
def progress_bar() -> Iterator[Progress]:
    """A bar on stderr that is gone when the work is done; nothing where stderr is not a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), _time_left_column())
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda what, share: bar.update(task, description=what, completed=share)


def time_left_text(share: float, elapsed: float) -> str:
    """How long the rest will take if it goes on as it went, roughly; "" while that would be a guess.

    Args:
        share: of all work that is behind.
        elapsed: [s] since the start.

    Example:
        >>> time_left_text(0.25, 20.0), time_left_text(0.5, 200.0), time_left_text(0.01, 9.0)
        ('about 60 s left', 'about 3 min left', '')
    """
    if not (LEAST_SHARE <= share < 1.0 and elapsed >= LEAST_SECONDS):
        return ""
    left = elapsed * (1.0 - share) / share
    if left < 90.0:
        step = 1 if left < 10.0 else 5
        return f"about {max(1, step * math.ceil(left / step))} s left"
    if left < 5400.0:
        return f"about {round(left / 60.0)} min left"
    return f"about {left / 3600.0:.1f} h left"


def _time_left_column() -> "ProgressColumn":
    from rich.progress import ProgressColumn, Task
    from rich.text import Text

    class TimeLeft(ProgressColumn):
        """What `time_left_text` says of a task."""

        def render(self, task: Task) -> Text:
            return Text(time_left_text(task.completed / (task.total or 1.0), task.elapsed or 0.0), style="bright_black")

    return TimeLeft()
