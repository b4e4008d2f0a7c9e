"""The gyroscope from stills, moves between them, whole turns or a turntable."""
