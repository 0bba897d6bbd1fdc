"""Models of structures and machines: masses, springs, elements, plants with ports, model files."""
