"""The effects of the catalogue, one a file."""
