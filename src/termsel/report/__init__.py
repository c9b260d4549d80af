"""What people see of a record: text, charts, pages."""
