"""Nodes, lines and sensors, and from where to look at them."""
