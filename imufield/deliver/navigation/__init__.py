"""Static navigation as a check of parameters: align, mechanise, and compare the drift with the drift to be expected."""
