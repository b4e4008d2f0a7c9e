"""Drawing: the box that stands for the instrument, one style of plots, and lines of words for a terminal."""
