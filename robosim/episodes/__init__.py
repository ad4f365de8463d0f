"""What happened in an episode: frames, columns of them, trajectories that run again."""
