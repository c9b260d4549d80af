"""Selection by regression: stepwise, nested, ridge, lasso."""
