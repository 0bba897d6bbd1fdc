"""Poles and shapes fitted to frequency responses, with the noise of their lines and the order."""
