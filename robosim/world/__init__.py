"""Where bodies are: robots and pellets as rigid bodies, moved only by wheel commands."""
