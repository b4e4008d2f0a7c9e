"""Of the standard library and NumPy, in a form that is loaded sooner and runs faster: dataclasses, the median."""
