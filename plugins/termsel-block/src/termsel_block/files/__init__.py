"""What a block is read from, and what it is written to."""
