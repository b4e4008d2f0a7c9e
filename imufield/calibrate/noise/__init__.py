"""Allan deviation and the noise figures read from it."""
