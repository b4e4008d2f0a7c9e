"""Views of the guide: terminal, plain lines, JSON lines, sound."""
