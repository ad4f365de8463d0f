"""The processes of a deployed team: a process a robot, the pheromone service, and the world."""
