"""What people see of a block: its record, summary and page."""
