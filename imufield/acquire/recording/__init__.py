"""Sessions on disk: written first, read again as a link."""
