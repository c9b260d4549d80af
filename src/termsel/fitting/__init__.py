"""One fitted model: adjustment, figures, residuals, diagnosis."""
