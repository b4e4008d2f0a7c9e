"""What talks to the person at the terminal: output, questions, choice of the view."""
