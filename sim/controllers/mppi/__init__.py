"""Sampling model-predictive control of both people at once."""
