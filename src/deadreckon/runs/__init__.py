"""Training and evaluation of agents, and run folders."""
