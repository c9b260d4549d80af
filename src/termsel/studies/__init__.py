"""Many runs: what a study asks for, its journal, executors and tables."""
