"""Runnable examples: the tower of `modal-report demo`, and the five stories of the gallery (modal/docs/gallery.md)."""
