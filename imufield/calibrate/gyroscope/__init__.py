"""The gyroscope from stills, moves, whole turns or a turntable: fit, choice of the model, covariance of the residuals."""
