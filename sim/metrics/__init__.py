"""Measures of a duet, each with its formula, unit and source; thresholds are in :mod:`sim.score`.

Arrays come in as ``[N, 2, ...]``: moments, then persons a and b. Results are per moment and person,
so that a report can name the worst moment.
"""
