"""The accelerometer from still positions: start, fit of bias, scale and misalignment, choice of the model, quality."""
