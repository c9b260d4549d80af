"""Files of a stranger: what they must not do, one module for each rule of docs/explanation/trust.md."""
