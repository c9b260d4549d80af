"""Photos whose camera is known: what is known, the model, the method and where it is read from."""
