"""The pages of a recording of a diagnosis."""
