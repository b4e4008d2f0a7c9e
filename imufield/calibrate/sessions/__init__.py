"""Several sessions of one instrument as one: what they share, what changes from day to day, what a new day will bring."""
