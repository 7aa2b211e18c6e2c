"""How good the generators are, by the measures of the paper and of bodies; see docs/results.md."""
