"""Models with effects fitted to records, in observer form and in free run."""
