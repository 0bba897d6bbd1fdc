"""Limits of acceptance, and whether a result meets them."""
