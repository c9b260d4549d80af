"""Best subsets by branch and bound: of columns (terms) and of rows (features)."""
