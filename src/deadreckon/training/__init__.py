"""The training loop: compiled chunks, checkpoints, resume."""
