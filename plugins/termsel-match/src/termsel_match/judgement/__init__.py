"""Which candidates agree, and what they and the others say of the model."""
