"""Drawing: what all pictures have in common, the box that stands for the instrument, and one style of plots."""
