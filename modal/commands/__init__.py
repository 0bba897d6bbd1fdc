"""The commands of `modal-report`, one file each; `modal.command` puts them together."""
