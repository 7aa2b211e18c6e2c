"""Servos on a wire: registers, packets, the transport, and the bus that speaks in joint names."""
