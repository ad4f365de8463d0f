"""Learning: stacked Q-networks, replay, techniques and the trainer. The only package that imports torch."""
