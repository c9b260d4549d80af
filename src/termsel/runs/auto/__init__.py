"""The strategy auto: a model chosen by what it predicts."""
