"""The same for a simulation program of which nothing is known but what it returns."""
