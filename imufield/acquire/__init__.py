"""From the wire to samples: rooms, and import addresses for other packages (``can_logs``, ``checksum``, ``exchange``)."""
