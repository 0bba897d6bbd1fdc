"""How much of each output is noise."""
