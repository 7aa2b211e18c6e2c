"""What no body can do is taken out of a reference before control, as little as possible of it."""
