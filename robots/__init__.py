"""The bodies: the human skeleton and humanoid, and servo robots as drop-in folders."""
