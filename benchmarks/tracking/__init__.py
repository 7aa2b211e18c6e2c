"""How well, and at what cost, controllers make duets happen in physics; see docs/tracking.md."""
