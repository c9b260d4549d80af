"""What the data say of corrections: which to try, and how far they scatter."""
