"""What decisions and updates cost on this machine, against the bare work under them."""
