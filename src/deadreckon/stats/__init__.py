"""Statistics that all other packages share: intervals, the bootstrap, and comparisons of scores, on plain arrays."""
