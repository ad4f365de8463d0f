"""Learning: algorithms, techniques, curriculum, and runs that resume. The only package that imports torch."""
