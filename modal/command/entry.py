"""The first lines of `modal-report`: requests to stop are noted before anything else is imported."""

from modal.command.stopping import Requests

__all__ = ["main"]


def main() -> None:
    """Run the command and leave with its exit status."""
    Requests.listen()
    from modal.command.main import leave

    leave()
