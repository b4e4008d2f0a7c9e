"""From the wire to samples: link, recorder, framer, layout decode, driver registry, sessions.

``can_logs``, ``checksum`` and ``exchange`` are import addresses for other packages; the code is in the rooms.
"""
