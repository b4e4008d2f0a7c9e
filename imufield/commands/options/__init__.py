"""The options of every command, each stated once: type, default, limits and help; the command line is made from them."""
