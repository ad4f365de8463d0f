"""Algorithms of robosim and of others on simple_spread: the task, each library's face, and the report."""
