"""The pages of a recording of modes."""
