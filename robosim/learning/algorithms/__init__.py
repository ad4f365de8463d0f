"""What learns: a file or folder for each algorithm, behind one protocol."""
