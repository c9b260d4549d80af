"""Reports on the quality of a georeference for archives: one content, several encodings."""
