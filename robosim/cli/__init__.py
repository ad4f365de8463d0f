"""The command `robosim`: parse, call, print."""
