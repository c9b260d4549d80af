"""Files of a stranger, and what they must not do: docs/explanation/trust.md says it in words."""
