"""Measuring what teams do, and what the simulator costs."""
