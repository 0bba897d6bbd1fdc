"""A structure with effects run along a record: drive, trajectory, linearisation, sensitivities."""
