"""Double DQN with replay: independent learners side by side, or one network for all."""
