"""Numbers, names and sentences as a person writes them; this part knows no type of ours."""
