"""What talks to the person at the terminal: output, progress, questions, choice of the view."""
