"""What happens in an episode, measured from its frames as they come."""
