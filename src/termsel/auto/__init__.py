"""Models fitted without a search, and the choice among them."""
