"""A realisation seen as modes: poles, shapes, indicators, and how modes and shapes compare."""
