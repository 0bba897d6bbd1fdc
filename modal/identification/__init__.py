"""The road from records to modes: the search for orders, the refined model, and the result."""
