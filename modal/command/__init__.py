"""The command `modal-report`, one file a command."""
