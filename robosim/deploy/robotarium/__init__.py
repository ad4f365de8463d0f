"""A policy as an experiment of the Robotarium: flat files, which run there on numpy alone (Wilson 2020)."""
