"""From the wire to samples: link, recorder, framer, layout decode, driver registry, sessions."""
