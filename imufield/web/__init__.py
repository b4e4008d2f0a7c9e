"""The page: what the guide shows, in a browser on this machine or on a phone, and the marks that come back."""
