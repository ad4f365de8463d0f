"""The robot: its data sheet, its kinematics, and the drivers that turn actions into wheel speeds."""
