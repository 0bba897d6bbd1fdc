"""Is it a mode of the system? Found again, driven by the inputs, how probable, and in words why."""
