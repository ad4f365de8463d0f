"""From bodies to a Dec-POMDP: cells, modes, pheromones, observations and rewards, in batches."""
