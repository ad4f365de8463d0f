"""The faces that others plug into: batched, PettingZoo, Gymnasium."""
