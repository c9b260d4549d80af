"""Features as tables: columns, ids, attributes, frames."""
