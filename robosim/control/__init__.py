"""Controllers: scripted ones, and trained policies run in numpy."""
