"""Where robots and pellets are: one protocol, rigid bodies or the grid behind it, and who chooses."""
