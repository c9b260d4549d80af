"""Many runs: what a study asks for, its journal, executors, statistics and tables."""
