"""Onto metal: retargeting, limits, Dynamixel buses, the player and the command line."""
