"""What a selection is worth: figures, comparison, sentences."""
