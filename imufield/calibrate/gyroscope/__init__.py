"""The gyroscope from stills, moves, whole turns or a turntable: fit of bias, scale, misalignment and g-sensitivity."""
