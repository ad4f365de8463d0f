"""Value decomposition: VDN and QMIX, which learn the team's value as a function of the robots' values."""
