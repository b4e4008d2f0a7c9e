"""What each command does, without the terminal's argument parsing (that is imufield.cli)."""
