"""What people see of a study: pages, figures, files."""
