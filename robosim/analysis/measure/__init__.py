"""Figures of an episode, read off its frames as they come."""
