"""Clogs: who blocks whom, since when, and why."""
