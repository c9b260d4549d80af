"""Maps of residuals."""
