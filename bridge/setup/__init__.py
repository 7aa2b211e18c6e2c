"""Setting up real robots: finding servos, giving them ids, calibrating and moving single joints."""
