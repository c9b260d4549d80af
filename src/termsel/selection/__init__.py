"""Which terms and features to use: problems, criteria, solvers, best subsets."""
