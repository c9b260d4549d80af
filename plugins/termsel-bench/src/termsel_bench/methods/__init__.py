"""What the benchmark compares: termsel, methods of other packages, and scripts one would write."""
