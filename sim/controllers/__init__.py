"""Ways to make two simulated people follow a reference."""
