"""The cells of a study: identity, journal, table, folder."""
