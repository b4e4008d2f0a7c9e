"""The accelerometer from still positions: start, fit, choice of the model, quality."""
