"""Sample time: from counters, time stamps and host arrival to seconds; losses counted."""
