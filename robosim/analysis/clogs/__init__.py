"""Clogs: who stands in whose way, since when, and why."""
