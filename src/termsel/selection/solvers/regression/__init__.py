"""Selection by regression, and ridge."""
