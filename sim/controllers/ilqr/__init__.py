"""Receding-horizon control: iLQR over targets of the joints."""
