"""Which effects: screen, search, smaller models, decision."""
